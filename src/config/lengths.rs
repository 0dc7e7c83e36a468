//! Converts lengths with units, such as `"2mm"`, into the numbers of a configuration: millimetres if the setting's name
//! says so, otherwise metres. Elements of arrays may have units as well. Settings that are no lengths keep such a text,
//! which is then refused as no number. This file knows from the defaults which settings exist, and of those without a
//! unit in their names which ones are lengths.

use crate::range;
use std::ops::Range;
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

/// The settings that count metres. All others without a unit in their names count seconds, or something that has no
/// unit.
const METRES: [&str; 7] = [
    "cell_size",
    "depth_step",
    "depths",
    "max",
    "min",
    "noise_at_1m",
    "nominal_slope",
];

/// A setting's name, as far as it says what the setting counts.
#[derive(Clone, Copy)]
pub(super) struct Name<'a> {
    /// The section that it stands in; empty outside of all.
    pub section: &'a str,
    /// Its own name.
    pub key: &'a str,
}

impl Name<'_> {
    /// How many of what it counts make a metre; `None` of what is no length.
    fn per_metre(self) -> Option<f64> {
        // The limits of a verdict count what their section's name says.
        let name = match self.key {
            "amber" | "red" => self.section,
            key => key,
        };
        if name.ends_with("_mm") {
            return Some(1e3);
        }
        METRES.contains(&name).then_some(1.0)
    }
}

/// The same text with numbers in place of lengths that have a unit. Its lines are where they were.
pub(super) fn as_numbers(text: &str, defaults: &Table) -> String {
    let mut numbers = Vec::new();
    if let Ok(table) = DeTable::parse(text) {
        find("", table.get_ref(), defaults, &mut numbers);
    }
    numbers.sort_by_key(|(at, _)| at.start);
    let mut text = text.to_owned();
    for (at, number) in numbers.into_iter().rev() {
        text.replace_range(at, &format!("{number:?}"));
    }
    text
}

/// The same value with numbers in place of lengths that have a unit.
pub(super) fn as_number(name: Name<'_>, value: Value, default: Option<&Value>) -> Value {
    match (value, default) {
        (Value::Table(entries), Some(Value::Table(defaults))) => {
            let section = name.key;
            let entries = entries.into_iter().map(|(key, value)| {
                let inner = Name { section, key: &key };
                let number = as_number(inner, value, defaults.get(&key));
                (key, number)
            });
            Value::Table(entries.collect())
        }
        (Value::Array(items), Some(Value::Array(defaults))) => {
            let of_item = |(index, item)| as_number(name, item, element(defaults, index));
            Value::Array(items.into_iter().enumerate().map(of_item).collect())
        }
        (Value::String(text), Some(Value::Float(_))) => {
            length(name, &text).map_or(Value::String(text), Value::Float)
        }
        (value, _) => value,
    }
}

fn find(
    section: &str,
    table: &DeTable<'_>,
    defaults: &Table,
    numbers: &mut Vec<(Range<usize>, f64)>,
) {
    for (key, value) in table {
        let key = key.get_ref().as_ref();
        find_in(Name { section, key }, value, defaults.get(key), numbers);
    }
}

fn find_in(
    name: Name<'_>,
    value: &Spanned<DeValue<'_>>,
    default: Option<&Value>,
    numbers: &mut Vec<(Range<usize>, f64)>,
) {
    match (value.get_ref(), default) {
        (DeValue::Table(entries), Some(Value::Table(defaults))) => {
            find(name.key, entries, defaults, numbers);
        }
        (DeValue::Array(items), Some(Value::Array(defaults))) => {
            for (index, item) in items.iter().enumerate() {
                find_in(name, item, element(defaults, index), numbers);
            }
        }
        (DeValue::String(text), Some(Value::Float(_))) => {
            numbers.extend(length(name, text).map(|number| (value.span(), number)));
        }
        _ => {}
    }
}

/// The default of an array's element; one behind the default's end is like the last one.
fn element(defaults: &[Value], index: usize) -> Option<&Value> {
    defaults.get(index).or(defaults.last())
}

/// The number that a setting takes for a length with its unit; `None` for another text, and of what is no length.
fn length(name: Name<'_>, text: &str) -> Option<f64> {
    let metres = range::metres(text).filter(|_| range::has_unit(text))?;
    Some(name.per_metre()? * metres)
}
