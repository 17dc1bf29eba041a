//! Tells cargo that the binary embeds migrations, pages and the book: without this a new file would go
//! unnoticed until some source file changes.

fn main() {
    println!("cargo:rerun-if-changed=../../migrations");
    println!("cargo:rerun-if-changed=../../web");
    println!("cargo:rerun-if-changed=../../docs");
}
