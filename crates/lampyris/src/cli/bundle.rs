//! The page's modules as one classic script. Browsers refuse to import modules from the disk, so each module
//! becomes a function that returns what it exports. It reads the dialect that the page is written in: named
//! and default imports and exports by their own statements, no cycles.

use super::output::Failure;
use crate::http::page_part;

/// What the script calls the table of modules.
const TABLE: &str = "$parts";

/// A module as the body of a function.
#[derive(Debug, Default)]
struct Body {
    text: String,
    /// What it exports: the name, and the expression behind it.
    exports: Vec<(String, String)>,
    /// The modules that it imports, in order.
    imports: Vec<String>,
}

/// A module of the page with all that it imports, in an order in which nothing is used before it is there.
///
/// # Errors
/// Where a part is missing, two import each other, or a statement is none of the dialect.
pub fn script(entry: &str) -> Result<String, Failure> {
    let mut script = format!("'use strict';\nconst {TABLE} = {{}};\n");
    add(entry, &mut Vec::new(), &mut Vec::new(), &mut script)?;
    // No text inside of a script may end it.
    Ok(script.replace("</script", "<\\/script"))
}

fn add(
    path: &str,
    done: &mut Vec<String>,
    open: &mut Vec<String>,
    script: &mut String,
) -> Result<(), Failure> {
    if done.iter().any(|known| known == path) {
        return Ok(());
    }
    if open.iter().any(|waiting| waiting == path) {
        return Err(Failure::Error(format!(
            "the page's parts import each other: {} -> {path}",
            open.join(" -> ")
        )));
    }
    let text = page_part(path).ok_or_else(|| Failure::Error(format!("the page has no part `{path}`")))?;
    let body = body(path, &text)?;
    open.push(path.to_owned());
    for import in &body.imports {
        add(import, done, open, script)?;
    }
    open.pop();
    done.push(path.to_owned());
    let exports: Vec<String> = body.exports.iter().map(|(name, value)| format!("{name}: {value}")).collect();
    script.push_str(&format!(
        "{TABLE}['{path}'] = (() => {{\n{}\nreturn {{ {} }};\n}})();\n",
        body.text.trim(),
        exports.join(", ")
    ));
    Ok(())
}

/// Rewrites the imports and exports of a module.
fn body(path: &str, text: &str) -> Result<Body, Failure> {
    let mut body = Body::default();
    let mut rest = text;
    let mut before = '\n';
    while let Some(at) = statement(rest, before) {
        body.text.push_str(&rest[..at]);
        let taken = one(path, &rest[at..], &mut body).ok_or_else(|| {
            let line: String = rest[at..].chars().take(60).collect();
            Failure::Error(format!(
                "the page's part `{path}` has a statement that a report cannot hold: {line}"
            ))
        })?;
        // What stays of an export is no beginning of another one.
        before = ' ';
        rest = &rest[at + taken..];
    }
    body.text.push_str(rest);
    Ok(body)
}

/// Where the next import or export begins: at the start of a line, or behind a statement of a minified
/// module.
fn statement(text: &str, before: char) -> Option<usize> {
    let begins = |at: usize| matches!(text[..at].chars().next_back().unwrap_or(before), '\n' | ';' | '}');
    let word = |at: usize| {
        let rest = &text[at..];
        ["import ", "import{", "export ", "export{"].iter().any(|word| rest.starts_with(word))
    };
    text.match_indices("import")
        .chain(text.match_indices("export"))
        .map(|(at, _)| at)
        .filter(|at| word(*at) && begins(*at))
        .min()
}

/// Rewrites one statement at the start of a text; how much of the text it takes. An exported declaration
/// loses its first word alone.
fn one(path: &str, text: &str, body: &mut Body) -> Option<usize> {
    let end = text.find(';').map(|at| at + 1);
    let (word, rest) = text.split_at("import".len());
    let rest = rest.trim_start();
    if word == "import" {
        let statement = &text["import".len()..end?];
        let (names, source) = statement.rsplit_once("from")?;
        let source = body.import(path, source)?;
        let names = match listed(names) {
            Some(names) => {
                names.iter().map(|(from, to)| format!("{from}: {to}")).collect::<Vec<_>>().join(", ")
            }
            None => format!("default: {}", names.trim()),
        };
        body.text.push_str(&format!("const {{ {names} }} = {source};"));
        return end;
    }
    if rest.starts_with('{') {
        let statement = &text["export".len()..end?];
        let (list, source) = statement.split_at(statement.find('}')? + 1);
        let source = match source.split_once("from") {
            Some((_, source)) => Some(body.import(path, source)?),
            None => None,
        };
        for (from, to) in listed(list)? {
            body.exports
                .push((to, source.as_ref().map_or(from.clone(), |source| format!("{source}.{from}"))));
        }
        return end;
    }
    let declaration = text.len() - rest.len();
    if let Some(value) = rest.strip_prefix("default ") {
        body.exports.push(("default".to_owned(), "$default".to_owned()));
        body.text.push_str("const $default = ");
        return Some(text.len() - value.len());
    }
    let named = ["async function ", "function ", "const ", "class "]
        .iter()
        .find_map(|kind| rest.strip_prefix(kind))?;
    let name = named
        .split(|c: char| !(c.is_alphanumeric() || c == '_' || c == '$'))
        .next()
        .filter(|name| !name.is_empty())?;
    body.exports.push((name.to_owned(), name.to_owned()));
    Some(declaration)
}

/// `{ a, b as c }` as pairs; nothing where it is no list.
fn listed(text: &str) -> Option<Vec<(String, String)>> {
    let inner = text.trim().strip_prefix('{')?.strip_suffix('}')?;
    let pair = |entry: &str| {
        let (from, to) = entry.split_once(" as ").unwrap_or((entry, entry));
        (from.trim().to_owned(), to.trim().to_owned())
    };
    Some(inner.split(',').filter(|entry| !entry.trim().is_empty()).map(pair).collect())
}

impl Body {
    /// Notes what a quoted, relative specifier means; the expression that holds the module.
    fn import(&mut self, path: &str, specifier: &str) -> Option<String> {
        let specifier = specifier.trim().trim_end_matches(';').trim_matches(['\'', '"']);
        let mut folders: Vec<&str> = path.split('/').collect();
        folders.pop();
        for part in specifier.split('/') {
            match part {
                "." => {}
                ".." => {
                    folders.pop()?;
                }
                name => folders.push(name),
            }
        }
        let source = folders.join("/");
        let expression = format!("{TABLE}['{source}']");
        self.imports.push(source);
        Some(expression)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statements_become_what_a_function_may_hold() {
        let text = "import a from './a.mjs';\nimport {\n  b,\n  c as d,\n} from '../x/b.js';\nexport { b \
            };\nexport * as all;\n";
        assert!(body("pages/one.js", text).is_err(), "what is not understood is a fault");
        let text = text.replace(
            "export * as all;\n",
            "export const e = 1;\nexport async function f() {}\nexport { g as h } from './g.js';\n",
        );
        let body = body("pages/one.js", &text).ok().unwrap_or_default();
        assert_eq!(body.imports, ["pages/a.mjs", "x/b.js", "pages/g.js"]);
        assert!(body.text.contains("const { default: a } = $parts['pages/a.mjs'];"), "{}", body.text);
        assert!(body.text.contains("const { b: b, c: d } = $parts['x/b.js'];"), "{}", body.text);
        assert!(
            body.text.contains("\nconst e = 1;\nasync function f() {}\n") && !body.text.contains("export"),
            "{}",
            body.text
        );
        let exports: Vec<String> =
            body.exports.iter().map(|(name, value)| format!("{name}={value}")).collect();
        assert_eq!(exports, ["b=b", "e=e", "f=f", "h=$parts['pages/g.js'].g"]);
    }

    #[test]
    fn a_minified_module_is_understood() {
        let body = body(
            "vendor/h.mjs",
            "import{options as n}from\"./p.mjs\";var t=n;function u(){}export{t as x,u as y};\n",
        )
        .ok()
        .unwrap_or_default();
        assert_eq!(body.text.trim(), "const { options: n } = $parts['vendor/p.mjs'];var t=n;function u(){}");
        assert_eq!(body.exports, [("x".to_owned(), "t".to_owned()), ("y".to_owned(), "u".to_owned())]);
    }

    #[test]
    fn every_page_can_be_bundled() {
        for entry in ["report.js", "main.js"] {
            let script = script(entry).ok().unwrap_or_default();
            assert!(
                script.contains("$parts['charts/strips.js']")
                    && !script.contains("\nimport ")
                    && !script.contains("\nexport "),
                "{entry}"
            );
            assert!(!script.contains("</script"), "{entry} could end its own element");
        }
    }
}
