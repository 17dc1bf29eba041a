//! Tells cargo that the library embeds documents: without this a new file would go unnoticed until some
//! source file changes.

fn main() {
    println!("cargo:rerun-if-changed=../../config");
}
