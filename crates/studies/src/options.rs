//! Options that several studies share.

use clap::Args;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct First {
    /// First seed of what is synthetic.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

#[derive(Debug, Args)]
pub struct Html {
    /// Write tables and charts as one HTML file that needs no network.
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct Csv {
    /// Write every run as a line of a CSV file.
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct Each {
    /// Print a line per world, or per search, as it is done.
    #[arg(long)]
    pub each: bool,
}

#[derive(Debug, Args)]
pub struct RoomCount {
    /// How many synthetic rooms are fitted; of the house, at most its eleven.
    #[arg(long, default_value_t = 20)]
    pub rooms: u64,
}

#[derive(Debug, Args)]
pub struct Only {
    /// Only cases whose name holds this, such as `matched wind`.
    #[arg(long)]
    pub only: Option<String>,
}

#[derive(Debug, Args)]
pub struct Seeds {
    #[command(flatten)]
    pub first: First,
    /// How many seeds each method runs with on each function.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    pub seeds: u64,
}

#[derive(Debug, Args)]
pub struct Worlds {
    #[command(flatten)]
    pub first: First,
    /// How many worlds are looked at, of each level where there are two.
    #[arg(long, default_value_t = 30)]
    pub worlds: u64,
    #[command(flatten)]
    pub only: Only,
    #[command(flatten)]
    pub each: Each,
}

impl Worlds {
    /// The first seed, how many worlds, of which kinds, and whether a line each is printed.
    pub fn parts(&self) -> (u64, u64, Option<&str>, bool) {
        (self.first.seed, self.worlds, self.only.only.as_deref(), self.each.each)
    }
}
