//! `lampyris models`: documents of models and effects on a running server.

use super::document::{is_document, read_document};
use super::output::{Failure, print};
use super::pages::{self, Page};
use super::server::{Answer, Call, Server, fault_line, segment};
use super::table::{self, Column};
use lampyris_core::model::export::ExportFormat;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const COLUMNS: &[Column] = &[("model", "/id"), ("title", "/title"), ("parent", "/parent")];

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    server: Server,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// List models.
    List(Page),
    /// Show one model: states, inputs, parameters, outputs.
    Show {
        /// Its id, such as room3+wind_infiltration.
        id: String,
    },
    /// Say what is wrong with a model document without taking it. Exit code 3 where something is.
    Validate {
        /// A TOML or JSON document; `-` for JSON on standard input.
        file: PathBuf,
    },
    /// Take a model document.
    Post {
        /// A TOML or JSON document; `-` for JSON on standard input.
        file: PathBuf,
    },
    /// Write the model of a fit, or the model in force of a system, for other programs.
    Export {
        /// A fit, or a system such as room/4.
        of: String,
        /// How it is written.
        #[arg(long, default_value = "json", value_parser = ExportFormat::ALL.map(ExportFormat::as_str))]
        format: String,
    },
    /// Make a model by adding an effect.
    AddEffect {
        /// The model to start from.
        model: String,
        /// An effect of the catalogue, such as wind_infiltration, or the file of an effect document.
        effect: String,
    },
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let server = &arguments.server;
    match &arguments.verb {
        Verb::List(page) => pages::list(server, "/models", page, &[], COLUMNS),
        Verb::Show { id } => {
            server.show(&server.get(&format!("/models/{}", segment(id)))?, describe);
            Ok(())
        }
        Verb::Validate { file } => {
            let answer = server.call("POST", "/models/validate", Call::json(&read_document(file)?))?;
            server.show(&answer, |document| check(server, document));
            if answer.document["valid"] == true { Ok(()) } else { Err(Failure::Rejected) }
        }
        Verb::Post { file } => {
            let answer = server.call("POST", "/models", Call::json(&read_document(file)?))?;
            taken(server, &answer, describe);
            Ok(())
        }
        Verb::Export { of, format } => {
            let path = match of.split_once('/') {
                Some((kind, id)) => format!("/systems/{}/{}/model", segment(kind), segment(id)),
                None => format!("/fits/{}/model", segment(of)),
            };
            print(server.get(&format!("{path}?format={format}"))?.text.trim_end());
            Ok(())
        }
        Verb::AddEffect { model, effect } => {
            let file = Path::new(effect);
            let body = if is_document(file) { read_document(file)? } else { json!({"effect": effect}) };
            let answer =
                server.call("POST", &format!("/models/{}/effects", segment(model)), Call::json(&body))?;
            taken(server, &answer, version);
            Ok(())
        }
    }
}

fn taken(server: &Server, answer: &Answer, text: impl FnOnce(&Value) -> String) {
    server.show(answer, text);
    if answer.status == 200 && !server.json() {
        print("it was there already");
    }
}

fn check(server: &Server, check: &Value) -> String {
    match check["errors"].as_array().map(Vec::as_slice) {
        None | Some([]) => "valid".to_owned(),
        Some(faults) => {
            let page = check["see"].as_str().map(|page| server.leads_to(page));
            faults.iter().map(fault_line).chain(page).collect::<Vec<_>>().join("\n")
        }
    }
}

fn version(version: &Value) -> String {
    let parts: [Column; 4] =
        [("model", "/id"), ("parent", "/parent"), ("added", "/diff/effect"), ("title", "/diff/title")];
    let mut text = table::fields(version, &parts);
    for (heading, pointer) in [("terms", "/diff/terms"), ("outputs", "/diff/outputs")] {
        for (name, term) in version.pointer(pointer).and_then(Value::as_object).into_iter().flatten() {
            text.push_str(&format!("\n{heading}  {name}: + {}", table::cell(term, "")));
        }
    }
    for (name, meaning) in version.pointer("/diff/replace").and_then(Value::as_object).into_iter().flatten() {
        text.push_str(&format!("\nreplaced  {name} = {}", table::cell(meaning, "")));
    }
    let names = version.pointer("/diff/parameters").and_then(Value::as_object).into_iter().flatten();
    names.for_each(|(name, parameter)| {
        let cell = |field: &str| table::cell(parameter, field);
        text.push_str(&format!(
            "\nparameter  {name} [{}] {} to {}",
            cell("/unit"),
            cell("/lower"),
            cell("/upper")
        ));
    });
    text
}

fn describe(model: &Value) -> String {
    let parts: [Column; 5] = [
        ("model", "/id"),
        ("title", "/title"),
        ("parent", "/parent"),
        ("effects", "/effects"),
        ("hash", "/hash"),
    ];
    let mut text = table::fields(model, &parts);
    let tables: [(&str, &[Column]); 4] = [
        ("states", &[("state", "/name"), ("unit", "/unit")]),
        ("inputs", &[("input", "/name"), ("channel", "/channel"), ("unit", "/unit"), ("hold", "/hold")]),
        (
            "parameters",
            &[
                ("parameter", "/name"),
                ("unit", "/unit"),
                ("bounds", "/bounds"),
                ("scale", "/scale"),
                ("nominal", "/nominal"),
                ("what", "/title"),
            ],
        ),
        ("outputs", &[("output", "/channel"), ("unit", "/unit"), ("noise", "/noise_sd")]),
    ];
    for (field, columns) in tables {
        let rows: Vec<&Value> = model[field].as_array().into_iter().flatten().collect();
        if !rows.is_empty() {
            text.push_str(&format!("\n\n{}", table::rows_of(&rows, columns)));
        }
    }
    text
}
