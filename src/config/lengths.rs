//! Converts lengths with units, such as `"2mm"`, into the numbers of a configuration: millimetres if the key says so,
//! otherwise metres. This file knows only from the defaults which settings exist.

use crate::range;
use std::ops::Range;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

/// The same text with numbers in place of lengths that have a unit. Its lines are where they were.
pub(super) fn as_numbers(text: &str, defaults: &Table) -> String {
    let mut numbers = Vec::new();
    if let Ok(table) = DeTable::parse(text) {
        find(table.get_ref(), defaults, &mut numbers);
    }
    numbers.sort_by_key(|(at, _)| at.start);
    let mut text = text.to_owned();
    for (at, number) in numbers.into_iter().rev() {
        text.replace_range(at, &format!("{number:?}"));
    }
    text
}

/// The same value with numbers in place of lengths that have a unit.
pub(super) fn as_number(key: &str, value: Value, default: Option<&Value>) -> Value {
    match (value, default) {
        (Value::Table(section), Some(Value::Table(defaults))) => {
            let entries = section.into_iter().map(|(key, value)| {
                let number = as_number(&key, value, defaults.get(&key));
                (key, number)
            });
            Value::Table(entries.collect())
        }
        (Value::String(text), Some(Value::Float(_))) => {
            length(key, &text).map_or(Value::String(text), Value::Float)
        }
        (value, _) => value,
    }
}

fn find(table: &DeTable<'_>, defaults: &Table, numbers: &mut Vec<(Range<usize>, f64)>) {
    for (key, value) in table {
        let key = key.get_ref().as_ref();
        match (value.get_ref(), defaults.get(key)) {
            (DeValue::Table(section), Some(Value::Table(defaults))) => {
                find(section, defaults, numbers);
            }
            (DeValue::String(text), Some(Value::Float(_))) => {
                numbers.extend(length(key, text).map(|number| (value.span(), number)));
            }
            _ => {}
        }
    }
}

/// The number that a setting takes for a length with its unit; `None` for another text.
fn length(key: &str, text: &str) -> Option<f64> {
    let metres = range::metres(text).filter(|_| range::has_unit(text))?;
    Some(if key.ends_with("_mm") {
        1e3 * metres
    } else {
        metres
    })
}
