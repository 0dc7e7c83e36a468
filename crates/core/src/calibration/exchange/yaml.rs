//! Parses the part of YAML that calibration files use: names nested by indentation, plain values, lists in brackets
//! over one line or more, and lists of such lists. Everything else is refused with its line.

use std::collections::BTreeMap;

/// Values by their names, joined by dots.
pub(super) type Tree = BTreeMap<String, Value>;

/// A value.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    /// A plain word or number.
    Plain(String),
    /// Numbers, of nested lists one after the other.
    Numbers(Vec<f64>),
}

/// Reads a text.
pub(super) fn read(text: &str) -> Result<Tree, String> {
    let mut tree = Tree::new();
    // Names with their indentation, the outermost first.
    let mut path: Vec<(usize, String)> = Vec::new();
    let mut lines = text.lines().enumerate();
    while let Some((number, raw)) = lines.next() {
        let line = without_comment(raw);
        let inner = line.trim();
        if inner.is_empty() || inner == "---" || inner.starts_with('%') {
            continue;
        }
        let indent = line.len() - line.trim_start().len();
        let wrong = |what: &str| format!("line {}: {what}: {inner:.60?}", number + 1);
        if let Some(item) = inner.strip_prefix("- ") {
            let name = joined(&path);
            let mut list = item.trim().to_owned();
            take_list(&mut list, &mut lines);
            let row = numbers(&list).ok_or_else(|| wrong("expected a list of numbers"))?;
            match tree.entry(name).or_insert(Value::Numbers(Vec::new())) {
                Value::Numbers(all) => all.extend(row),
                Value::Plain(_) => return Err(wrong("a list follows a value")),
            }
            continue;
        }
        let Some((name, value)) = inner.split_once(':') else {
            return Err(wrong("expected NAME: VALUE"));
        };
        while path.last().is_some_and(|(depth, _)| *depth >= indent) {
            path.pop();
        }
        path.push((indent, name.trim().to_owned()));
        let mut value = value.trim().to_owned();
        if value.is_empty() {
            continue;
        }
        take_list(&mut value, &mut lines);
        let value = match value.starts_with('[') {
            true => Value::Numbers(numbers(&value).ok_or_else(|| wrong("expected numbers"))?),
            false => Value::Plain(value.trim_matches(['"', '\'']).to_owned()),
        };
        if tree.insert(joined(&path), value).is_some() {
            return Err(wrong("a name that is there twice"));
        }
    }
    Ok(tree)
}

fn joined(path: &[(usize, String)]) -> String {
    let names: Vec<&str> = path.iter().map(|(_, name)| name.as_str()).collect();
    names.join(".")
}

fn without_comment(line: &str) -> &str {
    let start = line.match_indices('#').map(|(k, _)| k);
    let mut start = start.filter(|&k| k == 0 || line[..k].ends_with(' '));
    start.next().map_or(line, |k| &line[..k])
}

/// Goes on with a list that does not end on its line.
fn take_list<'a>(list: &mut String, lines: &mut impl Iterator<Item = (usize, &'a str)>) {
    while list.starts_with('[') && !list.ends_with(']') {
        let Some((_, next)) = lines.next() else {
            return;
        };
        list.push(' ');
        list.push_str(without_comment(next).trim());
    }
}

fn numbers(list: &str) -> Option<Vec<f64>> {
    let inner = list.strip_prefix('[')?.strip_suffix(']')?.trim();
    if inner.is_empty() {
        return Some(Vec::new());
    }
    let number = |part: &str| part.trim().parse().ok().filter(|v: &f64| v.is_finite());
    inner.trim_end_matches(',').split(',').map(number).collect()
}

/// Numbers under a name.
pub(super) fn list<'a>(tree: &'a Tree, name: &str) -> Result<&'a [f64], String> {
    match tree.get(name) {
        Some(Value::Numbers(numbers)) => Ok(numbers),
        Some(Value::Plain(text)) => {
            Err(format!("{name} is {text:.40?}, expected a list of numbers"))
        }
        None => Err(format!("{name} is missing")),
    }
}

/// Exactly so many numbers under a name.
pub(super) fn exactly<const N: usize>(tree: &Tree, name: &str) -> Result<[f64; N], String> {
    let found = list(tree, name)?;
    found
        .try_into()
        .map_err(|_| format!("{name} has {} values, expected {N}", found.len()))
}

/// A word under a name.
pub(super) fn word<'a>(tree: &'a Tree, name: &str) -> Result<&'a str, String> {
    match tree.get(name) {
        Some(Value::Plain(text)) => Ok(text),
        Some(Value::Numbers(_)) => Err(format!("{name} is a list, expected one value")),
        None => Err(format!("{name} is missing")),
    }
}

/// Whether a file has a value under a name, or under a name below it.
pub(super) fn is_there(tree: &Tree, name: &str) -> bool {
    let is_below = |key: &String| {
        let rest = key.strip_prefix(name);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
    };
    tree.keys().any(is_below)
}

/// A word under a name, or this one if the file does not have the name.
pub(super) fn word_or<'a>(
    tree: &'a Tree,
    name: &str,
    otherwise: &'a str,
) -> Result<&'a str, String> {
    match is_there(tree, name) {
        true => word(tree, name),
        false => Ok(otherwise),
    }
}

/// A picture's side, from a number.
pub(super) fn side(value: f64) -> Result<usize, String> {
    let is_side = value.fract() == 0.0 && (1.0..=16_384.0).contains(&value);
    is_side
        .then_some(value as usize)
        .ok_or_else(|| format!("picture size {value}, expected 1 to 16384"))
}
