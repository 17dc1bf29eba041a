//! The language of models: what `/language` answers, what its page says, and what the program reads are one.

use crate::support::TestApp;
use lampyris_core::model::catalogue::{Catalogue, Composition};
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::plant::PlantSpec;
use lampyris_core::model::process::ReactionsSpec;
use lampyris_core::model::spec::OutputSpec;
use lampyris_core::model::{Bindings, ModelId, compile};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

const PAGE: &str = include_str!("../../../../docs/reference/model-language.md");
const RECIPE: &str = include_str!("../../../../docs/how-to/add-an-effect.md");
/// The model on the page whose names its expressions use.
const MODEL: &str = "between";

/// The fenced blocks of a page that bear a mark.
fn blocks<'a>(page: &'a str, mark: &str) -> Vec<&'a str> {
    let fence = format!("\n```{mark}\n");
    page.split(&fence).skip(1).map(|rest| rest.split("\n```").next().unwrap()).collect()
}

/// The documents that a page writes into files.
fn written(page: &str) -> Vec<&str> {
    page.split(".toml <<'END'\n").skip(1).map(|rest| rest.split("\nEND").next().unwrap()).collect()
}

/// The rows of the table of a page that begins with this heading, as cells.
fn rows<'a>(page: &'a str, heading: &str) -> Vec<Vec<&'a str>> {
    // A row of another table may begin with the same word.
    let is_heading = |from: &usize| page[*from..].lines().nth(1).is_some_and(|line| line.starts_with("|--"));
    let found = page.match_indices(&format!("\n| {heading} |")).map(|(from, _)| from + 1).find(is_heading);
    let from = found.unwrap_or_else(|| panic!("no table of {heading}"));
    let lines = page[from..].lines().take_while(|line| line.starts_with('|')).skip(2);
    lines.map(|line| line.trim_matches('|').split('|').map(str::trim).collect()).collect()
}

/// The code spans of a cell.
fn codes(cell: &str) -> Vec<&str> {
    cell.split('`').skip(1).step_by(2).collect()
}

/// A list of an answer, by the names of its items.
fn named(list: &Value, name: &str) -> BTreeMap<String, Value> {
    list.as_array()
        .unwrap()
        .iter()
        .map(|item| (item[name].as_str().unwrap().to_owned(), item.clone()))
        .collect()
}

/// The catalogue with all models of the page; its sets have two members.
fn catalogue() -> (Catalogue, Bindings) {
    let mut catalogue = Catalogue::builtin().unwrap();
    let mut reactions = BTreeMap::new();
    for text in written(PAGE).into_iter().chain(blocks(PAGE, "toml")) {
        if ReactionsSpec::is_one(text) {
            let found = ReactionsSpec::from_toml(text).unwrap();
            reactions.insert(found.id.clone(), found);
        } else if text.contains("\nreactions = ") {
            let plant = PlantSpec::from_toml(text).unwrap().expand(&reactions).unwrap();
            catalogue.add_model(ModelDocument::Spec(Box::new(plant)));
        } else if !text.contains("\nexplain = ") {
            catalogue.add_model(ModelDocument::from_toml(text).unwrap());
        }
    }
    let neighbours = ("neighbours".to_owned(), vec!["1".to_owned(), "2".to_owned()]);
    (catalogue, Bindings { sets: [neighbours].into(), channels: None })
}

fn composed(catalogue: &Catalogue, bindings: &Bindings, id: &str) -> (Composition, Bindings) {
    let composition = catalogue.compose(&id.parse::<ModelId>().unwrap()).unwrap();
    let sets = if composition.spec.sets.is_empty() { BTreeMap::new() } else { bindings.sets.clone() };
    (composition, Bindings { sets, channels: None })
}

#[test]
fn every_document_of_the_page_compiles() {
    let (catalogue, bindings) = catalogue();
    let mut ids = Vec::new();
    let app = TestApp::start();
    for text in [written(PAGE), blocks(PAGE, "toml"), written(RECIPE)].concat() {
        let document: Value = toml::from_str(text).unwrap();
        ids.push(document["id"].as_str().unwrap().to_owned());
        if document.get("explain").is_some() {
            app.json("POST", "/effects", &document).expect(201);
        } else if document.get("process").is_none() {
            let (composition, bindings) = composed(&catalogue, &bindings, ids.last().unwrap());
            compile(&composition, &bindings).unwrap_or_else(|faults| panic!("{text}\n{faults:#?}"));
            if document.get("reactions").is_none() {
                app.json("POST", "/models", &document).expect(201);
            }
        }
    }
    let expected =
        ["lone", "between", "room2b", "oven", "draught", "shaded_gain", "oxidation", "pond", "exhaust_fan"];
    assert_eq!(ids, expected);
    app.json("POST", "/models/between/effects", &json!({"effect": "draught"})).expect(201);
    app.json("POST", "/models/between/effects", &json!({"effect": "shaded_gain:tinted"})).expect(201);
}

#[test]
fn every_expression_of_the_page_has_the_unit_or_the_fault_that_it_says() {
    let (catalogue, bindings) = catalogue();
    let (base, bindings) = composed(&catalogue, &bindings, MODEL);
    let faults = |expr: &str, unit: &str| {
        let mut with = base.clone();
        let output = OutputSpec { expr: expr.to_owned(), unit: unit.to_owned(), noise_sd: 1.0 };
        with.spec.outputs.insert("shown".to_owned(), output);
        compile(&with, &bindings).err().unwrap_or_default()
    };
    let lines = |mark: &str| {
        let lines: Vec<(&str, &str)> = blocks(PAGE, mark)
            .into_iter()
            .flat_map(str::lines)
            .map(|line| line.split_once(" # ").unwrap())
            .map(|(expr, said)| (expr.trim(), said.trim()))
            .collect();
        assert!(lines.len() > 10, "{mark}: {lines:?}");
        lines
    };
    for (expr, unit) in lines("expr") {
        let faults = faults(expr, unit);
        assert!(faults.is_empty(), "{expr}: {faults:#?}");
    }
    for (expr, code) in lines("refused") {
        let faults = faults(expr, "-");
        assert!(faults.iter().any(|fault| fault.code == code), "{expr}: {faults:#?}");
        assert!(faults.iter().all(|fault| fault.detail.starts_with("line 1, column ")), "{faults:#?}");
    }
}

#[test]
fn the_page_lists_what_the_service_answers() {
    let app = TestApp::start();
    let answer = app.get("/language").expect(200);
    let tag = answer.header("etag").to_owned();
    app.get_with("/language", &[("if-none-match", &tag)]).expect(304);
    let language = answer.json();
    app.get(language["see"].as_str().unwrap()).expect(200);

    assert_eq!(blocks(PAGE, "ebnf"), [language["grammar"].as_str().unwrap().trim_end()]);

    let call = |function: &Value| {
        let arguments: Vec<&str> =
            function["arguments"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
        format!("{}({})", function["name"].as_str().unwrap(), arguments.join(", "))
    };
    let calls: Vec<String> = language["functions"].as_array().unwrap().iter().map(call).collect();
    let shown: Vec<&str> = rows(PAGE, "function").iter().map(|row| codes(row[0])[0]).collect();
    assert_eq!(shown, calls);

    let mut shown = BTreeMap::new();
    for row in rows(PAGE, "quantity") {
        for symbol in codes(row[1]) {
            let twice = shown.insert(symbol.to_owned(), codes(row[2])[0].to_owned());
            assert!(twice.is_none(), "{symbol}");
        }
    }
    let units = named(&language["units"], "symbol");
    let units =
        units.into_iter().map(|(symbol, unit)| (symbol, unit["dimension"].as_str().unwrap().to_owned()));
    assert_eq!(shown, units.collect::<BTreeMap<_, _>>());

    let first = |heading: &str| -> BTreeSet<String> {
        rows(PAGE, heading).iter().flat_map(|row| codes(row[0])).map(str::to_owned).collect()
    };
    let names = |list: &str, name: &str| named(&language[list], name).into_keys().collect::<BTreeSet<_>>();
    for (list, heading) in
        [("holds", "`hold`"), ("scales", "`scale`"), ("steppers", "`stepper`"), ("signs", "`sign`")]
    {
        assert_eq!(first(heading), names(list, "name"), "{list}");
    }

    let computed = named(&language["computed"], "channel");
    assert_eq!(first("channel"), computed.keys().cloned().collect::<BTreeSet<_>>());
    for row in rows(PAGE, "channel") {
        assert_eq!(codes(row[1]), [computed[codes(row[0])[0]]["unit"].as_str().unwrap()], "{row:?}");
    }

    let limits = named(&language["limits"], "name");
    assert_eq!(first("limit"), limits.keys().cloned().collect::<BTreeSet<_>>());
    for row in rows(PAGE, "limit") {
        let limit = &limits[codes(row[0])[0]];
        let unit = limit["unit"].as_str().unwrap();
        let said = row[1].replace(',', "");
        assert_eq!(said, format!("{} {unit}", limit["value"]).replace(" -", "").replace(".0", ""), "{row:?}");
    }

    let fields = |table: &Value| -> BTreeMap<String, bool> {
        let fields = table["fields"].as_array().unwrap().iter();
        fields.map(|field| (field["name"].as_str().unwrap().to_owned(), field["required"] == true)).collect()
    };
    for (name, document) in named(&language["documents"], "name") {
        let mut shown = BTreeMap::new();
        for row in rows(PAGE, &format!("field of `{name}`")) {
            let needed = codes(row[1]);
            let is_needed = |field: &str| row[1] == "yes" || needed.contains(&field);
            shown.extend(codes(row[0]).into_iter().map(|field| (field.to_owned(), is_needed(field))));
        }
        let described = fields(&document);
        assert_eq!(shown, described, "{name}");
    }
    let checks = named(&language["checks"], "name");
    assert_eq!(first("`kind`"), checks.keys().cloned().collect::<BTreeSet<_>>());
    for row in rows(PAGE, "`kind`") {
        let shown: BTreeSet<String> = codes(row[1]).into_iter().map(str::to_owned).collect();
        let described = fields(&checks[codes(row[0])[0]]);
        assert_eq!(shown, described.into_keys().collect::<BTreeSet<_>>(), "{row:?}");
    }
}

#[test]
fn faults_of_documents_lead_to_the_page() {
    let app = TestApp::start();
    let model = json!({"id": "bad", "title": "Bad", "states": {}, "equations": {}, "outputs": {}});
    let effect = json!({"id": "bad", "title": "Bad", "explain": "It is bad.", "terms": {"T_r": "nothing"}});
    let page = "/docs/book/reference/model-language.html";
    for (path, body) in [
        ("/models", model.clone()),
        ("/models/preview", json!({"model": model})),
        ("/models/rc2/effects", effect.clone()),
        ("/effects", effect),
    ] {
        assert_eq!(app.json("POST", path, &body).problem(422, "invalid-request")["see"], page, "{path}");
    }
    assert_eq!(app.json("POST", "/models/validate", &model).expect(200).json()["see"], page);
    app.get(page).expect(200);
    // What is wrong with anything else says nothing of models.
    let problem =
        app.json("PUT", "/systems/room/1", &json!({"modle": "rc2"})).problem(422, "invalid-request");
    assert!(problem.get("see").is_none(), "{problem}");
}
