//! Tells cargo that the binary embeds the migrations: without this a new file in `migrations/` would go
//! unnoticed until some source file changes.

fn main() {
    println!("cargo:rerun-if-changed=migrations");
}
