//! The page of the book that holds every figure, made of the records of the studies.

use super::file::write;
use super::record::Record;
use super::row::{Limit, Row};
use lampyris::cli::Failure;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// A study that has a section.
struct Section {
    study: &'static str,
    title: &'static str,
    about: &'static str,
    /// The options with which its figures are taken for a release.
    options: &'static str,
}

const SECTIONS: [Section; 26] = [
    Section {
        study: "engine",
        title: "The engine and the controller's path",
        about: "A week of a synthetic room with four neighbours, simulated from its text, beside the same \
            method compiled by hand in lanes and beside a scalar fourth-order solver; one thread. Then polls \
            of `/params` with a matching tag, beside a bare route of the same library.",
        options: "",
    },
    Section {
        study: "counts",
        title: "What fixed inputs cost",
        about: "Simulations, derivatives and instructions (callgrind, one thread, vectors of 256 bits), which are the \
            same however busy a machine is. The whole tests fail where one is more than 5 % above its record.",
        options: "",
    },
    Section {
        study: "load",
        title: "Polls under load",
        about: "How long a controller waits for its parameters while all cores fit, and while eight clients \
            send megabytes of measurements. A poll has its time, whatever became of the one before, and its \
            latency counts from that time.",
        options: " --seconds 300",
    },
    Section {
        study: "fleet",
        title: "Nights of very many rooms",
        about: "One room of four weeks, copied until there are so many: a start of the service, a batch of a \
            job for each, and the fits that follow. What a fit costs may not depend on how many there are.",
        options: " --rooms 1000,10000,100000",
    },
    Section {
        study: "fleet-server",
        title: "The same nights on PostgreSQL",
        about: "Database and fits together on the cores of one machine, with one process that fits and with \
            four. A commit waits for the disk.",
        options: "",
    },
    Section {
        study: "nights",
        title: "What a night of one room costs",
        about: "Fits that begin at the served parameters, night by night on synthetic rooms, beside searches \
            everywhere: preparing, estimating, looking for changes and judging, on one core.",
        options: " --worlds 200",
    },
    Section {
        study: "room",
        title: "The search on synthetic rooms",
        about: "Rooms of 15 parameters, one week to fit: how often the default search ends within 1 % of the \
            best fit that any method is known to reach, and after how many simulations.",
        options: " --seed 40001",
    },
    Section {
        study: "functions",
        title: "The search methods on the functions of the thesis",
        about: "Chapter 5 of the thesis with its functions, budgets and settings, and the rivals beside it. \
            `--html FILE` writes the tables of every method and the claims of section 5.4.",
        options: " --seed 90000",
    },
    Section {
        study: "functions-hard",
        title: "Functions that are shifted, rotated and ill-conditioned",
        about: "Expected running times to three targets on the functions of the thesis, moved and turned, and on \
            thirteen of BBOB's in 5 and 10 dimensions, each seed an instance of its own.",
        options: " --seeds 10 --seed 501",
    },
    Section {
        study: "ablation",
        title: "What each modification of the firefly algorithm is worth",
        about: "Each modification alone removed from the thesis's cFA, and alone added to the original \
            algorithm: median errors, on how many seeds the change is for the better and for the worse, and \
            the chance of so uneven a count.",
        options: " --seed 90000",
    },
    Section {
        study: "complexity",
        title: "How the work of a generation grows",
        about: "Evaluations of one generation by the size of the population: formally its square for the FA, \
            and its power of 1.5 for cFA.",
        options: " --seed 90000",
    },
    Section {
        study: "likelihood",
        title: "Maximum likelihood",
        about: "The method `ctsm` on rooms that nothing moves but what is measured, and on rooms that chance \
            moves: convergence, and errors on the week after over those of the free-run fit. Then how often \
            the 95 % intervals hold the truth.",
        options: " --rooms 11 --worlds 200 --seed 12001",
    },
    Section {
        study: "diagnose",
        title: "What a diagnosis names",
        about: "Synthetic rooms whose truth is known; those called rich have two more thermal masses than \
            the model. An effect is material where knowing it lowers the test error by a tenth. Shares have \
            their counts, and Wilson's interval of 95 %.",
        options: " --worlds 100 --seed 731",
    },
    Section {
        study: "missing-heat",
        title: "Whether the missing heat is what was hidden",
        about: "Synthetic rooms of three weeks: how often the bands hold what was hidden hour by hour, and how \
            well the events that are told are those that were.",
        options: "",
    },
    Section {
        study: "proposals",
        title: "Whether the terms that are proposed are what was hidden",
        about: "Synthetic rooms whose hidden effect is in no catalogue but follows from something measured, at \
            both distances from the model; and rooms that hide nothing, or what nothing measured explains.",
        options: " --worlds 20 --seed 97",
    },
    Section {
        study: "real-proposals",
        title: "Whether proposals find what drives a measured room",
        about: "Channels have no names that say what they are. The measurements are not part of the project.",
        options: "",
    },
    Section {
        study: "experiments",
        title: "Whether experiments teach what they promise",
        about: "Two planned days behind four weeks of a synthetic room: widths of intervals, effects that could \
            not be told apart, hours within the bounds of comfort.",
        options: " --worlds 100 --seed 74",
    },
    Section {
        study: "change",
        title: "How soon a change is told",
        about: "Nights of synthetic rooms in which one conductance changes by a fifth, and quiet years.",
        options: "",
    },
    Section {
        study: "borrowing",
        title: "What rooms of a house learn from each other",
        about: "Synthetic houses of eleven rooms: the error of the week behind 5 and behind 28 days, alone, with \
            what the others' fits say, and with what the others truly are, which nobody can know.",
        options: " --worlds 8 --seed 12",
    },
    Section {
        study: "real",
        title: "What is named in measured rooms",
        about: "Windows of two weeks, and short records as a whole, with a known driver withheld; and the \
            same windows with the channels of other days, where nothing should be found. The measurements \
            are not part of the project.",
        options: "",
    },
    Section {
        study: "real-priors",
        title: "Whether measured rooms are what is usual",
        about: "Windows of two weeks, a week of them to learn from: fits that are drawn to the nominal values \
            (`log_normal`) beside free ones, by models with what drives the room and without. The \
            measurements are not part of the project.",
        options: "",
    },
    Section {
        study: "bands",
        title: "Whether forecasts of measured rooms say how far off they may be",
        about: "Windows of two weeks, then a forecast every six hours over the two weeks after, with the \
            inputs that came. Bands hold 95 % where the model lacks nothing; what nobody has logged widens \
            the errors and, as process noise, the bands. The measurements are not part of the project.",
        options: "",
    },
    Section {
        study: "plant",
        title: "Treatment plants",
        about: "Chapter 6 of the thesis on twins whose truth is simulated by another method: parameters from \
            three days of four effluents, and the eleven unseen days after.",
        options: " --seed 50",
    },
    Section {
        study: "diagnose-plant",
        title: "What a diagnosis of a plant names",
        about: "Twins of plant H with parameters of their own, from four days of effluent.",
        options: " --seed 711",
    },
    Section {
        study: "house",
        title: "A twin house",
        about: "Chapter 7 of the thesis on a twin of its house: sensors become rooms, one week is fitted and \
            one judged.",
        options: "",
    },
    Section {
        study: "loop",
        title: "A controller in the loop",
        about: "A predictive controller heats houses with drifting parameters for eight weeks, with \
            parameters of different age. Half-way the wind begins to blow through the house.",
        options: " --seed 11",
    },
];

const INTRODUCTION: &str = "\
# Measured

This page is made of documents that the studies leave behind, one for each run, with its command, its seed,
its date and its machine; nobody writes figures into it. `cargo build --release --workspace` puts the studies
beside `lampyris`, and `lampyris bench help` lists them. One more run replaces its document, and the page is
made anew:

```text
lampyris bench room --seed 40001 --record docs/results
lampyris bench results docs/results
```

Times depend on the machine, and on what else it does. Ratios are taken within one run, and some have a limit
that a run must keep: `lampyris bench` fails where one does not hold.
";

/// What was measured before studies left documents, with its date. A section goes when its study is recorded.
const EARLIER: &str = include_str!("results/earlier.md");

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The folder of the records; the page stands beside it, under the same name.
    #[arg(default_value = "docs/results")]
    folder: PathBuf,
}

/// Makes the page anew.
pub fn run(asked: &Arguments) -> Result<(), Failure> {
    write(&asked.folder.with_extension("md"), &page(&asked.folder)?)
}

/// The page of a folder of records.
fn page(folder: &Path) -> Result<String, Failure> {
    let mut page = INTRODUCTION.to_owned();
    for section in &SECTIONS {
        let Section { study, title, about, options } = section;
        // Writing to a text cannot fail, here and below.
        let _ = write!(page, "\n## {title}\n\n{}\n", wrapped(about));
        let _ = match record(&folder.join(format!("{study}.json")))? {
            Some(record) => write!(page, "\n{}", recorded(study, &record)),
            None => writeln!(
                page,
                "\nNot recorded yet: `lampyris bench {study}{options} --record docs/results`. Older figures, \
                where\nthere are some, stand at [the end](#earlier-figures)."
            ),
        };
    }
    Ok(page + "\n" + EARLIER)
}

/// A record, where there is one.
pub fn record(file: &Path) -> Result<Option<Record>, Failure> {
    let error = |error: &dyn std::fmt::Display| Failure::Error(format!("{}: {error}", file.display()));
    match std::fs::read_to_string(file) {
        Ok(text) => serde_json::from_str(&text).map(Some).map_err(|found| error(&found)),
        Err(found) if found.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(found) => Err(error(&found)),
    }
}

fn recorded(study: &str, record: &Record) -> String {
    let Record { command, seed, date, seconds, release, machine, note, rows } = record;
    let seed = seed.map_or_else(String::new, |seed| format!(", seed {seed}"));
    let (cpu, cores) = (&machine.cpu, machine.cores);
    let note = note.as_ref().map_or_else(String::new, |note| format!(" {note}"));
    let source = format!(
        "`{command}`{seed}: {date}, release {release}, {cores} cores of {cpu}, {seconds:.0} s \
        ([document](results/{study}.json)).{note}"
    );
    let mut text = wrapped(&source) + "\n\n| what | value | unit | limit |\n|---|---:|---|---|\n";
    for row in rows {
        let what = row.what.replace('|', "\\|");
        // What is indented belongs to the row above.
        let what = what.strip_prefix("  ").map_or_else(|| what.clone(), |rest| format!("… {rest}"));
        let unit = if row.unit == "-" { "" } else { &row.unit };
        let _ = writeln!(text, "| {what} | {} | {unit} | {} |", figure(row.value), limit(row));
    }
    text
}

fn limit(row: &Row) -> String {
    let words = match row.limit {
        None => return String::new(),
        Some(Limit::AtMost(most)) => format!("at most {}", figure(most)),
        Some(Limit::AtLeast(least)) => format!("at least {}", figure(least)),
    };
    if row.holds() { words } else { format!("{words}: **does not hold**") }
}

/// A value in four figures; whole numbers are written out.
fn figure(value: f64) -> String {
    let size = value.abs();
    if !size.is_finite() {
        return "none".to_owned();
    }
    if size.fract() == 0.0 && size < 1e7 {
        return format!("{value:.0}");
    }
    if size >= 1e6 {
        return format!("{value:.3e}");
    }
    if size < 1e-3 {
        return format!("{value:.1e}");
    }
    let decimals = (3.0 - size.log10().floor()).max(0.0) as usize;
    let text = format!("{value:.decimals$}");
    if decimals == 0 { text } else { text.trim_end_matches('0').trim_end_matches('.').to_owned() }
}

/// A paragraph in the lines of the book.
fn wrapped(text: &str) -> String {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.is_empty() => line.push_str(word),
            Some(line) if line.chars().count() + word.chars().count() < 110 => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_what_the_records_say() {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/results"));
        let committed = std::fs::read_to_string(folder.with_extension("md")).unwrap();
        assert!(
            committed == page(folder).ok().unwrap(),
            "`lampyris bench results docs/results` makes it anew"
        );
        let known = |name: &str| SECTIONS.iter().any(|section| format!("{}.json", section.study) == name);
        for entry in std::fs::read_dir(folder).unwrap() {
            let name = entry.unwrap().file_name().into_string().unwrap();
            assert!(known(&name), "{name} has no section");
        }
    }

    #[test]
    fn a_record_becomes_a_table() {
        let text = r#"{"command": "lampyris bench room", "seed": 3, "date": "2026-11-25", "seconds": 12.0,
            "release": "1.0.0", "machine": {"cpu": "A", "cores": 2}, "note": "Busy.", "rows": [
            {"what": "one | two", "value": 0.25, "unit": "x", "limit": {"at_most": 0.2}},
            {"what": "  the same", "value": null, "unit": "-"}]}"#;
        let record: Record = serde_json::from_str(text).unwrap();
        let shown = recorded("room", &record);
        assert!(
            shown.starts_with("`lampyris bench room`, seed 3: 2026-11-25, release 1.0.0, 2 cores of A, 12 s")
        );
        assert!(shown.contains("| one \\| two | 0.25 | x | at most 0.2: **does not hold** |\n"), "{shown}");
        assert!(shown.ends_with("| … the same | none |  |  |\n"), "{shown}");
    }

    #[test]
    fn figures_have_four_digits() {
        let shown = [1352.0, 15.4321, 0.0, 0.92, 1234.5, 2.3e-7, 99.999_9, -0.5, 881_463_199.0].map(figure);
        assert_eq!(shown, ["1352", "15.43", "0", "0.92", "1234", "2.3e-7", "100", "-0.5", "8.815e8"]);
    }
}
