//! Files that a study writes where they are named.

use lampyris::cli::Failure;
use std::path::Path;

/// Writes a page or a list, and says so.
pub fn write(file: &Path, text: &str) -> Result<(), Failure> {
    std::fs::write(file, text).map_err(|error| Failure::Error(format!("{}: {error}", file.display())))?;
    eprintln!("written: {}", file.display());
    Ok(())
}
