//! No file imports one that imports it, however long the way round: enforced over the sources as text.
//!
//! Imports are `use` statements and paths inside of the code. What a folder's `mod.rs` shows of its files by
//! `pub use` is a face: whoever imports from it imports from the file behind, and the face itself imports
//! nothing.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod sources;

use sources::{code, is_source, is_test, sources};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// The rooms of the estimation, in the order in which its data pass them.
const ESTIMATE: [&str; 15] = [
    "decompose",
    "problem",
    "fit",
    "assess",
    "forecast",
    "search",
    "uncertainty",
    "discretisation",
    "report",
    "likelihood",
    "run",
    "segments",
    "pooling",
    "gate",
    "tune",
];
/// The longest chain of faces behind each other.
const MOST_FACES: usize = 5;

/// The place of a module in its crate; that of the crate itself is empty.
type Module = Vec<String>;
/// What a file imports: modules, and by which names.
type Imports = BTreeMap<Module, BTreeSet<String>>;

/// The files of one crate.
#[derive(Default)]
struct Crate {
    /// Code without strings and comments, and whether the file is a face.
    files: BTreeMap<Module, (String, bool)>,
    /// Where the names of faces come from: path from the face.
    shown: BTreeMap<(Module, String), Vec<String>>,
}

/// A `use` statement: whether it shows what it imports, and one path for each name.
struct Use {
    is_public: bool,
    paths: Vec<Vec<String>>,
}

impl Crate {
    /// Reads the files of a crate by their paths below `src`.
    fn read(texts: &BTreeMap<String, String>) -> Self {
        let mut found = Self::default();
        // A program beside a library is another crate.
        let root = if texts.contains_key("lib") { "lib" } else { "main" };
        for (path, text) in texts {
            let mut module: Module = path.split('/').map(str::to_owned).collect();
            let is_root = path == root;
            if is_root {
                module.clear();
            } else if path == "main" {
                continue;
            }
            let is_folder = module.last().is_some_and(|name| name == "mod");
            if is_folder {
                module.pop();
            }
            let has_children = texts.keys().any(|other| other.starts_with(&format!("{path}/")));
            found.files.insert(module, (bare(&code(text)), is_root || is_folder || has_children));
        }
        for (module, (code, is_face)) in &found.files {
            for statement in uses(code).0.into_iter().filter(|statement| *is_face && statement.is_public) {
                for mut path in statement.paths {
                    if path.last().is_some_and(|name| name == "self") {
                        path.pop();
                    }
                    found.shown.insert((module.clone(), path.last().cloned().unwrap_or_default()), path);
                }
            }
        }
        found
    }

    /// The file that a path of `module` leads to.
    fn resolve(&self, module: &[String], path: &[String], faces: usize) -> Option<Module> {
        let mut rest = path;
        let mut at = match rest.first()?.as_str() {
            "crate" => {
                rest = &rest[1..];
                Vec::new()
            }
            "super" | "self" => {
                let mut at = module.to_vec();
                while let Some(word @ ("super" | "self")) = rest.first().map(String::as_str) {
                    if word == "super" {
                        at.pop();
                    }
                    rest = &rest[1..];
                }
                at
            }
            first => Some(module.to_vec()).filter(|_| self.files.contains_key(&below(module, first)))?,
        };
        while let Some(name) = rest.first().filter(|name| self.files.contains_key(&below(&at, name))) {
            at.push(name.clone());
            rest = &rest[1..];
        }
        let behind = rest
            .first()
            .and_then(|name| self.shown.get(&(at.clone(), name.clone())))
            .filter(|_| faces < MOST_FACES);
        let behind = behind.and_then(|shown| self.resolve(&at, &[shown, &rest[1..]].concat(), faces + 1));
        Some(behind.unwrap_or(at))
    }

    /// What a file imports.
    fn imports(&self, module: &Module) -> Imports {
        let (code, is_face) = &self.files[module];
        let (statements, body) = uses(code);
        let used = statements
            .into_iter()
            .filter(|statement| !(*is_face && statement.is_public))
            .flat_map(|statement| statement.paths);
        let mut imports = Imports::new();
        for path in used.chain(inline(&body)) {
            if let Some(other) = self.resolve(module, &path, 0).filter(|other| other != module) {
                imports.entry(other).or_default().insert(path.last().cloned().unwrap_or_default());
            }
        }
        imports
    }

    /// Every circle, with what ties its files to each other.
    fn circles(&self) -> Vec<Vec<String>> {
        let imports: BTreeMap<&Module, Imports> =
            self.files.keys().map(|module| (module, self.imports(module))).collect();
        let reached: BTreeMap<&Module, BTreeSet<&Module>> =
            imports.keys().map(|module| (*module, reach(module, &imports))).collect();
        let mut told: BTreeSet<&Module> = BTreeSet::new();
        let mut circles = Vec::new();
        for module in imports.keys() {
            let circle: BTreeSet<&Module> =
                reached[module].iter().copied().filter(|other| reached[other].contains(module)).collect();
            if circle.is_empty() || !told.insert(module) {
                continue;
            }
            told.extend(&circle);
            let ties = circle.iter().flat_map(|file| {
                imports[file].iter().filter(|(other, _)| circle.contains(other)).map(move |tie| (file, tie))
            });
            circles.push(
                ties.map(|(file, (other, names))| {
                    format!("{} imports {} for {names:?}", shown(file), shown(other))
                })
                .collect(),
            );
        }
        circles
    }
}

/// All that a file leads to by imports.
fn reach<'a>(from: &'a Module, imports: &'a BTreeMap<&Module, Imports>) -> BTreeSet<&'a Module> {
    let mut reached = BTreeSet::new();
    let mut next = vec![from];
    while let Some(module) = next.pop() {
        next.extend(imports[module].keys().filter(|other| reached.insert(*other)));
    }
    reached
}

fn below(module: &[String], name: &str) -> Module {
    [module, &[name.to_owned()]].concat()
}

fn shown(module: &Module) -> String {
    if module.is_empty() { "the root".to_owned() } else { module.join("/") }
}

/// The code without the texts in it, which may look like code.
fn bare(code: &str) -> String {
    let characters: Vec<char> = code.chars().collect();
    let mut bare = String::new();
    let mut at = 0;
    while let Some(character) = characters.get(at).copied() {
        let next = characters.get(at + 1).copied();
        match character {
            '/' if next == Some('/') => at += characters[at..].iter().take_while(|c| **c != '\n').count(),
            // A lifetime has no second quote.
            '\'' if next == Some('\\') => {
                at += 3 + characters[at + 3..].iter().take_while(|c| **c != '\'').count()
            }
            '\'' if characters.get(at + 2) == Some(&'\'') => at += 3,
            '"' => {
                let hashes = bare.chars().rev().take_while(|c| *c == '#').count();
                let is_raw = bare.chars().rev().nth(hashes) == Some('r')
                    && bare.chars().rev().nth(hashes + 1).is_none_or(|c| !c.is_alphanumeric());
                at += 1;
                while let Some(inside) = characters.get(at).copied() {
                    let is_end = inside == '"'
                        && (!is_raw
                            || characters[at + 1..].iter().take_while(|c| **c == '#').count() >= hashes);
                    at += if inside == '\\' && !is_raw { 2 } else { 1 };
                    if is_end {
                        break;
                    }
                }
            }
            other => {
                bare.push(other);
                at += 1;
            }
        }
    }
    bare
}

/// The `use` statements of a file, and the code without them.
fn uses(code: &str) -> (Vec<Use>, String) {
    let (mut statements, mut body) = (Vec::new(), String::new());
    let mut lines = code.lines();
    while let Some(line) = lines.next() {
        let trimmed = line.trim_start();
        let sight = trimmed.strip_prefix("pub").map(|rest| {
            rest.strip_prefix('(').and_then(|rest| rest.split_once(')')).map_or(rest, |(_, rest)| rest)
        });
        let Some(rest) = sight.unwrap_or(trimmed).trim_start().strip_prefix("use ") else {
            body.push_str(line);
            body.push('\n');
            continue;
        };
        let mut statement = rest.to_owned();
        while !statement.contains(';') {
            let Some(line) = lines.next() else { break };
            statement.push_str(line.trim());
        }
        let statement = statement.split(';').next().unwrap_or_default();
        statements.push(Use { is_public: sight.is_some(), paths: expand("", statement) });
    }
    (statements, body)
}

/// The paths that an import with groups stands for.
fn expand(before: &str, import: &str) -> Vec<Vec<String>> {
    let Some((head, group)) = import.split_once('{') else {
        let path = format!("{before}{}", import.split(" as ").next().unwrap_or_default());
        return vec![path.split("::").map(|word| word.trim().to_owned()).collect()];
    };
    let (before, group) =
        (format!("{before}{}", head.trim()), group.trim_end().strip_suffix('}').unwrap_or(group));
    let mut parts = vec![String::new()];
    let mut depth = 0;
    for character in group.chars() {
        match character {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                parts.push(String::new());
                continue;
            }
            _ => {}
        }
        parts.last_mut().unwrap().push(character);
    }
    parts
        .iter()
        .map(|part| part.trim())
        .filter(|part| !part.is_empty())
        .flat_map(|part| expand(&before, part))
        .collect()
}

/// The paths inside of code: words joined by `::`.
fn inline(body: &str) -> Vec<Vec<String>> {
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let paths = body.split(|c: char| !is_word(c) && c != ':').filter(|text| text.contains("::"));
    paths.map(|text| text.split("::").map(|word| word.trim_matches(':').to_owned()).collect()).collect()
}

/// The files of every crate: their paths below `src` without the ending, and their texts.
fn crates() -> BTreeMap<String, BTreeMap<String, String>> {
    let mut crates: BTreeMap<String, BTreeMap<String, String>> = BTreeMap::new();
    for (path, text) in sources("crates").into_iter().filter(|(path, _)| is_source(path) && !is_test(path)) {
        let name = path.components().nth(1).unwrap().as_os_str().to_string_lossy().into_owned();
        let inside =
            path.strip_prefix(Path::new("crates").join(&name).join("src")).unwrap().with_extension("");
        crates.entry(name).or_default().insert(inside.to_string_lossy().into_owned(), text);
    }
    crates
}

#[test]
fn no_file_imports_one_that_imports_it() {
    let wrong: BTreeMap<String, Vec<Vec<String>>> = crates()
        .iter()
        .map(|(name, texts)| (name.clone(), Crate::read(texts).circles()))
        .filter(|(_, circles)| !circles.is_empty())
        .collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn no_room_of_the_estimation_imports_one_that_stands_after_it() {
    let core = Crate::read(&crates()["core"]);
    let place = |module: &Module| (module.first()? == "estimate").then(|| module.get(1)).flatten().cloned();
    let rank = |room: &str| {
        ESTIMATE.iter().position(|known| *known == room).unwrap_or_else(|| panic!("`{room}` has no place"))
    };
    let mut wrong = Vec::new();
    for module in core.files.keys() {
        let Some(room) = place(module) else { continue };
        let later = core
            .imports(module)
            .into_keys()
            .filter(|other| place(other).is_some_and(|other| rank(&other) > rank(&room)));
        wrong.extend(later.map(|other| format!("{} imports {}", shown(module), shown(&other))));
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn a_circle_is_found_and_a_face_is_none() {
    let circles = |files: &[(&str, &str)]| {
        let texts = files.iter().map(|(path, text)| ((*path).to_owned(), (*text).to_owned())).collect();
        Crate::read(&texts).circles()
    };
    let face = ("room/mod.rs", "mod wall;\npub use wall::Wall;\n");
    let face = (face.0.trim_end_matches(".rs"), face.1);
    let none = [
        ("lib", "pub mod room;"),
        face,
        ("room/wall", "pub struct Wall;"),
        ("room/door", "use super::{Wall};\nuse crate::room::Wall as W;"),
    ];
    assert!(circles(&none).is_empty(), "whoever imports from a face imports from the file behind it");
    let grouped = [
        face,
        ("room/wall", "use super::{\n    door::{Door, hinge},\n    Wall,\n};"),
        ("room/door", "fn f() -> crate::room::Wall {}"),
    ];
    let found = circles(&grouped);
    assert_eq!(
        found,
        [[
            "room/door imports room/wall for {\"Wall\"}",
            "room/wall imports room/door for {\"Door\", \"hinge\"}"
        ]]
    );
    let defining =
        [("room/mod", "mod wall;\npub struct Room(wall::Wall);"), ("room/wall", "use super::Room;")];
    assert_eq!(
        circles(&defining).len(),
        1,
        "a folder that defines what its files import, from what they define"
    );
    let texts = [
        ("a", "// use super::b::B;\nconst A: &str = \"super::b::B\"; const Q: char = '\"'; fn f<'a>() {}"),
        ("b", "use super::a::A;"),
    ];
    assert!(circles(&texts).is_empty(), "comments and texts import nothing");
    let tests = [
        ("a", "pub struct A;\n#[cfg(test)]\nmod tests {\n    use crate::b::B;\n}"),
        ("b", "use crate::a::A;"),
    ];
    assert!(circles(&tests).is_empty(), "unit tests may use more");
}
