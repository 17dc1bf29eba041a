//! Chapter 6 of the thesis: seven parameters of a treatment plant from three days of its effluent, and the
//! eleven days after.

pub mod case;
mod jena;
mod page;
mod realism;
mod tables;
mod thesis;

use super::file::write;
use super::options::{Each, First, Html, Only};
use super::page::Table;
use super::row::Row;
use case::Case;
use lampyris::cli::Failure;
use std::path::PathBuf;

/// The healthy plant and the one of the thesis.
const PLANTS: [&str; 2] = ["asm1_h", "asm1_l"];
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    pub first: First,
    #[command(flatten)]
    only: Only,
    #[command(flatten)]
    each: Each,
    #[command(flatten)]
    html: Html,
    /// Estimate plants by the thesis's own algorithm and settings instead: one firefly at a time, ten minutes
    /// each.
    #[arg(long)]
    thesis: bool,
    /// Estimate a plant from records with noise, outages, few samples, a drift and wrong fixed numbers
    /// instead.
    #[arg(long)]
    realism: bool,
    /// Drive a plant with the measured influent of Jena instead, from the folder that holds
    /// `jena_influent_15min.csv`.
    #[arg(long, value_name = "FOLDER")]
    jena: Option<PathBuf>,
}

/// Runs what is planned: the lines, and the tables for people.
pub fn run(asked: &Arguments) -> Result<(Vec<Row>, Vec<Table>), Failure> {
    let (mut rows, mut drawn, mut beside_them) = (Vec::new(), Vec::new(), Vec::new());
    let beside = asked.thesis || asked.realism || asked.jena.is_some();
    for (place, id) in PLANTS
        .into_iter()
        .enumerate()
        .filter(|(_, id)| asked.only.only.as_deref().is_none_or(|only| id.contains(only)))
    {
        let seed = asked.first.seed + place as u64;
        let clean = Case::new(id, seed, 0.0)?;
        if asked.thesis {
            let (more, table) = thesis::run(&clean)?;
            rows.extend(more);
            beside_them.push(table);
        }
        if beside && asked.html.html.is_none() {
            continue;
        }
        let noisy = Case::new(id, seed + 100, 1.0)?;
        rows.extend(clean.speed()?);
        let clean = clean.fit()?;
        rows.extend(clean.estimation(asked.each.each));
        let noisy = noisy.fit()?;
        rows.extend(noisy.intervals(asked.each.each));
        drawn.push((tables::table_6_8(&clean, &noisy), clean, noisy));
    }
    if asked.realism {
        let (more, table) = realism::run(asked.first.seed)?;
        rows.extend(more);
        beside_them.push(table);
    }
    if let Some(folder) = &asked.jena {
        let (more, table) = jena::run(folder)?;
        rows.extend(more);
        beside_them.push(table);
    }
    if let Some(file) = &asked.html.html {
        write(file, &page::document(&drawn, &beside_them, &rows)?)?;
    }
    Ok((rows, drawn.into_iter().map(|(table, ..)| table).chain(beside_them).collect()))
}
