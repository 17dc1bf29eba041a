//! Tells cargo that the binary embeds migrations and pages: without this a new file would go unnoticed until
//! some source file changes.

fn main() {
    println!("cargo:rerun-if-changed=../../migrations");
    println!("cargo:rerun-if-changed=../../web");
}
