//! The healthy plant on what really arrived: the influent of the treatment works of Jena, 13 to 27 March
//! 2003, every quarter of an hour.
//!
//! The record has flow, COD and ammonium; what else ASM1 asks for is assumed, and said in [`ASSUMED`].

use super::super::page::Table;
use super::super::row::Row;
use super::case::{OF_RANGE, range};
use lampyris::cli::{Failure, faults};
use lampyris_core::data::DRY_INFLUENT;
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::spec::OutputSpec;
use lampyris_core::model::{Bindings, Catalogue, Model, Nominal, compile};
use lampyris_core::simulate::{Inputs, Simulator, Stepper, Trajectory};
use std::path::Path;
use std::time::Instant;

const FILE: &str = "jena_influent_15min.csv";
const PLANT: &str = "asm1_h";
/// Hours between samples.
const STEP: f64 = 0.25;
/// Internal steps per sample of the oracle: five seconds.
const ORACLE_STEPS: usize = 180;
/// Samples of the mean influent before the record: a hundred days, ten sludge ages. A document's own warm-up
/// may not take so long.
const BEFORE: usize = 100 * 96;
/// The effluents that are held against the oracle, as everywhere.
const JUDGED: [&str; 4] = ["S_S_e", "X_S_e", "S_NH_e", "S_NO_e"];
/// Largest error of a balance in the steady state, as a share of what arrives.
const BALANCE: f64 = 1e-3;

const ASSUMED: [(&str, &str); 8] = [
    ("units", "flow in m3/d, COD and ammonium nitrogen in g/m3: inferred, the file does not say"),
    (
        "organic matter",
        "the measured COD in the shares of the dry-weather influent of the benchmark: S_I 7.9, S_S 18.2, X_I \
        13.4, X_S 53.1, X_BH 7.4 %",
    ),
    ("organic nitrogen", "stays with the COD as in the benchmark: S_ND 1.8, X_ND 2.8 g N per 100 g COD"),
    ("ammonium", "S_NH is the measured ammonium; no nitrate and no oxygen arrive"),
    (
        "alkalinity",
        "7 mol/m3 at the benchmark's 31.56 g N/m3, and a mole more per 14 g of ammonium nitrogen, which \
        comes with its charge",
    ),
    ("phosphorus", "left out: ASM1 has none"),
    (
        "size",
        "a plant larger in everything by the ratio of the mean flows is the plant itself with so much less \
        flow",
    ),
    (
        "artefacts",
        "kept: seven quarters of an hour above 56,000 m3/d at the start, and a morning below 4,000 m3/d",
    ),
];

/// Components of ASM1 with what they hold of COD and of nitrogen, in g/g (i_XB and i_XP of the plant's
/// reactions).
const HOLDS: [(&str, f64, f64); 13] = [
    ("S_I", 1.0, 0.0),
    ("S_S", 1.0, 0.0),
    ("X_I", 1.0, 0.0),
    ("X_S", 1.0, 0.0),
    ("X_BH", 1.0, 0.086),
    ("X_BA", 1.0, 0.086),
    ("X_P", 1.0, 0.06),
    ("S_O", -1.0, 0.0),
    ("S_NO", -4.57, 1.0),
    ("S_NH", 0.0, 1.0),
    ("S_ND", 0.0, 1.0),
    ("X_ND", 0.0, 1.0),
    ("S_ALK", 0.0, 0.0),
];
/// The oxygen demand of nitrogen gas.
const GAS: f64 = -1.71;

/// One quarter of an hour of the record.
#[derive(Debug, Clone, Copy)]
struct Quarter {
    flow: f64,
    cod: f64,
    ammonium: f64,
}

/// Drives the plant with the record.
pub fn run(folder: &Path) -> Result<(Vec<Row>, Table), Failure> {
    let record = read(&folder.join(FILE))?;
    let mean = mean(&record);
    let size = mean.flow / dry("Q");
    let model = model()?;
    let theta: Vec<f64> = model
        .parameters()
        .iter()
        .map(|parameter| if let Nominal::Value(value) = parameter.nominal { value } else { f64::NAN })
        .collect();
    let quarters: Vec<Quarter> = std::iter::repeat_n(mean, BEFORE).chain(record.iter().copied()).collect();
    let columns = model
        .inputs()
        .iter()
        .map(|input| quarters.iter().map(|quarter| influent(&input.name, *quarter, size)).collect())
        .collect();
    let inputs = Inputs::from_columns(&model, columns, STEP);
    let begun = Instant::now();
    let run = simulated(&model, &inputs, &theta, Stepper::Rkc, 1)?;
    let seconds = begun.elapsed().as_secs_f64();
    let fine = simulated(&model, &inputs, &theta, Stepper::Rk4, ORACLE_STEPS)?;
    let plant = Plant { model: &model, run: &run, record: &record, size };
    let judged = model.outputs().iter().zip(run.outputs.iter().zip(&fine.outputs));
    let error = |(ours, fine): (&Vec<f64>, &Vec<f64>)| {
        ours.iter().zip(fine).map(|(ours, fine)| (ours - fine).abs()).fold(0.0, f64::max)
            / range(fine.iter().copied())
    };
    let worst = judged
        .filter(|(output, _)| JUDGED.contains(&output.channel.as_str()))
        .map(|(_, pair)| error(pair))
        .fold(0.0, f64::max);
    let [cod, nitrogen] = plant.balances(mean);
    let rows = vec![
        Row::new(
            format!("{PLANT}, {size:.2} times as large: 100 days of its mean influent and two weeks of Jena"),
            1e3 * seconds,
            "ms",
        ),
        Row::new("  largest error beside steps of 5 s by RK4, of the range", worst, "-").at_most(OF_RANGE),
        Row::new("  lowest concentration in effluent and return sludge", plant.lowest(), "g/m3")
            .at_least(-1e-6),
        Row::new("  share of the COD that is removed", plant.removed(cod_of), "-").at_least(0.85),
        Row::new("  share of the nitrogen that is removed", plant.removed(nitrogen_of), "-").at_least(0.4),
        Row::new("  steady state of the mean influent: COD unaccounted for, of what arrives", cod, "-")
            .at_most(BALANCE),
        Row::new("  steady state of the mean influent: nitrogen unaccounted for", nitrogen, "-")
            .at_most(BALANCE),
    ];
    Ok((rows, plant.table()))
}

/// The outputs of the plant over the record; the samples before it are left out.
fn simulated(
    model: &Model,
    inputs: &Inputs,
    theta: &[f64],
    stepper: Stepper,
    substeps: usize,
) -> Result<Trajectory, Failure> {
    let mut run =
        Simulator::new(model, inputs, &[], stepper, substeps).run(&[theta], inputs.samples()).remove(0);
    if run.diverged {
        return Err(Failure::Error(format!("the plant left physics, stepped by {stepper:?}")));
    }
    run.outputs.iter_mut().for_each(|values| drop(values.drain(..BEFORE)));
    Ok(run)
}

/// The record by its named columns.
fn read(file: &Path) -> Result<Vec<Quarter>, Failure> {
    let wrong = |what: String| Failure::Error(format!("{}: {what}", file.display()));
    let text = std::fs::read_to_string(file).map_err(|error| wrong(error.to_string()))?;
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let place = |name: &str| {
        names
            .iter()
            .position(|known| *known == name)
            .ok_or_else(|| wrong(format!("there is no column `{name}`")))
    };
    let places = [place("Q_m3_d")?, place("COD_g_m3")?, place("NH4_N_g_m3")?];
    let quarter = |(row, line): (usize, &str)| {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |place: usize| {
            cells.get(place).and_then(|cell| cell.parse::<f64>().ok()).filter(|value| value.is_finite())
        };
        let [flow, cod, ammonium] = places.map(number);
        let quarter =
            flow.zip(cod).zip(ammonium).map(|((flow, cod), ammonium)| Quarter { flow, cod, ammonium });
        quarter.ok_or_else(|| wrong(format!("row {} has no number where one is needed", row + 2)))
    };
    lines.enumerate().map(quarter).collect()
}

/// Means, weighed by the flow.
fn mean(record: &[Quarter]) -> Quarter {
    let flow: f64 = record.iter().map(|quarter| quarter.flow).sum();
    let load =
        |of: fn(&Quarter) -> f64| record.iter().map(|quarter| quarter.flow * of(quarter)).sum::<f64>() / flow;
    Quarter {
        flow: flow / record.len() as f64,
        cod: load(|quarter| quarter.cod),
        ammonium: load(|quarter| quarter.ammonium),
    }
}

fn dry(name: &str) -> f64 {
    DRY_INFLUENT.iter().find(|(known, _)| *known == name).map_or(0.0, |(_, value)| *value)
}

/// An input of the plant in a quarter of an hour.
fn influent(name: &str, quarter: Quarter, size: f64) -> f64 {
    let organic: f64 = ["S_I", "S_S", "X_I", "X_S", "X_BH"].into_iter().map(dry).sum();
    match name {
        "Q" => quarter.flow / size,
        "S_NH" => quarter.ammonium,
        "S_ALK" => dry("S_ALK") + (quarter.ammonium - dry("S_NH")) / 14.0,
        other => dry(other) * quarter.cod / organic,
    }
}

/// The plant with the outputs that its balances need.
fn model() -> Result<Model, Failure> {
    let mut catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
    let Some(ModelDocument::Spec(mut spec)) = catalogue.model(PLANT).cloned() else {
        return Err(Failure::Error(format!("there is no model {PLANT}")));
    };
    spec.outputs.clear();
    let mut output = |channel: String, expr: String, unit: &str| {
        spec.outputs.insert(channel, OutputSpec { expr, unit: unit.to_owned(), noise_sd: 1.0 });
    };
    for (name, ..) in HOLDS {
        let unit = if name == "S_ALK" { "mol/m3" } else { "g/m3" };
        output(format!("{name}_e"), format!("{name}_e"), unit);
        output(format!("{name}_r"), format!("{name}_r"), unit);
    }
    let gas = |tank: &str| format!("V[{tank}]*(1 - Y_H)/(2.86*Y_H)*growth_H_anoxic[{tank}]");
    output("gas".to_owned(), format!("{} + {}", gas("anoxic"), gas("aerobic")), "g/h");
    output("air".to_owned(), "V[aerobic]*kLa[aerobic]*(S_O_sat - S_O[aerobic])".to_owned(), "g/d");
    output("kLa".to_owned(), "kLa[aerobic]".to_owned(), "1/d");
    output("TSS".to_owned(), "TSS[1]".to_owned(), "g/m3");
    output("sludge".to_owned(), "TSS[aerobic]".to_owned(), "g/m3");
    output("wasted".to_owned(), "Q_w".to_owned(), "m3/d");
    let id = spec.id.parse().map_err(|error| Failure::Error(format!("{error}")))?;
    catalogue.add_model(ModelDocument::Spec(spec));
    let composition = catalogue.compose(&id).map_err(|found| faults(&found))?;
    compile(&composition, &Bindings::default()).map_err(|found| faults(&found))
}

/// What a component holds, by `HOLDS`.
type Holds = fn(&(&'static str, f64, f64)) -> f64;

fn cod_of(component: &(&'static str, f64, f64)) -> f64 {
    // What is removed is organic matter: oxygen and nitrate count in the balance alone.
    component.1.max(0.0)
}

fn nitrogen_of(component: &(&'static str, f64, f64)) -> f64 {
    component.2
}

/// What the plant made of the record.
struct Plant<'a> {
    model: &'a Model,
    run: &'a Trajectory,
    record: &'a [Quarter],
    size: f64,
}

impl Plant<'_> {
    fn output(&self, channel: &str) -> &[f64] {
        let place = self.model.outputs().iter().position(|output| output.channel == channel);
        place.map_or(&[], |place| self.run.outputs[place].as_slice())
    }

    /// What a stream holds at a sample, per m3: the effluent `e` or the return sludge `r`.
    fn content(&self, stream: char, k: usize, holds: Holds) -> f64 {
        HOLDS
            .iter()
            .map(|component| holds(component) * self.output(&format!("{}_{stream}", component.0))[k])
            .sum()
    }

    fn arriving(&self, quarter: Quarter, holds: Holds) -> f64 {
        HOLDS.iter().map(|component| holds(component) * influent(component.0, quarter, self.size)).sum()
    }

    /// Clear water that leaves, in m3/d.
    fn leaving(&self, quarter: Quarter) -> f64 {
        quarter.flow / self.size - self.output("wasted")[0]
    }

    fn lowest(&self) -> f64 {
        let streams = HOLDS
            .iter()
            .flat_map(|(name, ..)| ['e', 'r'].map(|stream| self.output(&format!("{name}_{stream}"))));
        streams.flatten().copied().fold(f64::INFINITY, f64::min)
    }

    /// The share of what arrives over the two weeks that the effluent does not carry.
    fn removed(&self, holds: Holds) -> f64 {
        let arrived: f64 =
            self.record.iter().map(|quarter| quarter.flow / self.size * self.arriving(*quarter, holds)).sum();
        let left: f64 = self
            .record
            .iter()
            .enumerate()
            .map(|(k, quarter)| self.leaving(*quarter) * self.content('e', k, holds))
            .sum();
        1.0 - left / arrived
    }

    /// COD and nitrogen that the steady state of the mean influent makes or loses, as shares of what arrives.
    /// The hundred days end at the first sample.
    fn balances(&self, mean: Quarter) -> [f64; 2] {
        let (gas, air) = (24.0 * self.output("gas")[0], self.output("air")[0]);
        let share = |holds: Holds, gains: f64| {
            let arrived = mean.flow / self.size * self.arriving(mean, holds);
            let left = self.leaving(mean) * self.content('e', 0, holds)
                + self.output("wasted")[0] * self.content('r', 0, holds);
            ((arrived + gains - left) / arrived).abs()
        };
        // Oxygen is negative demand: the air brings some, and the gas carries some away.
        [share(|component| component.1, -air - GAS * gas), share(nitrogen_of, -gas)]
    }

    fn table(&self) -> Table {
        let line = |name: &str, arriving: Option<Vec<f64>>, leaving: Vec<f64>| {
            let cells = [arriving, Some(leaving)].map(|values| {
                values.map_or_else(
                    || "-".to_owned(),
                    |values| {
                        let mean = values.iter().sum::<f64>() / values.len() as f64;
                        let (low, high) =
                            values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
                                (low.min(*x), high.max(*x))
                            });
                        format!("{mean:.2} ({low:.2} to {high:.2})")
                    },
                )
            });
            std::iter::once(name.to_owned()).chain(cells).collect::<Vec<_>>()
        };
        let arrived =
            |holds: Holds| Some(self.record.iter().map(|quarter| self.arriving(*quarter, holds)).collect());
        let left = |holds: Holds| (0..self.record.len()).map(|k| self.content('e', k, holds)).collect();
        let mut rows = vec![
            line("COD, g/m3", arrived(cod_of), left(cod_of)),
            line("nitrogen, g/m3", arrived(nitrogen_of), left(nitrogen_of)),
        ];
        for (title, channel) in [
            ("ammonium S_NH, g/m3", "S_NH_e"),
            ("nitrate S_NO, g/m3", "S_NO_e"),
            ("substrate S_S, g/m3", "S_S_e"),
            ("substrate X_S, g/m3", "X_S_e"),
            ("alkalinity, mol/m3", "S_ALK_e"),
            ("suspended solids, g/m3", "TSS"),
            ("solids of the aerobic tank, g/m3", "sludge"),
            ("aeration kLa, 1/d", "kLa"),
        ] {
            let name = channel.trim_end_matches("_e");
            let component = HOLDS.iter().any(|(known, ..)| *known == name);
            let arriving = component
                .then(|| self.record.iter().map(|quarter| influent(name, *quarter, self.size)).collect());
            rows.push(line(title, arriving, self.output(channel).to_vec()));
        }
        rows.extend(
            ASSUMED.map(|(what, how)| vec![format!("assumed: {what}"), how.to_owned(), String::new()]),
        );
        Table {
            id: "jena",
            title: format!("Plant {PLANT} on the influent of Jena, 13 to 27 March 2003"),
            note: "Means over the samples, with the lowest and the highest. Before the record came 100 days \
                of its mean influent."
                .to_owned(),
            head: ["", "arrives", "leaves"].map(str::to_owned).to_vec(),
            rows,
        }
    }
}
