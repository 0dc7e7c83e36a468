//! Converts lengths with units, such as `"2mm"`, into the numbers of a configuration: millimetres if the key says so,
//! otherwise metres. Elements of arrays may have units as well. This file knows only from the defaults which settings
//! exist.

use crate::range;
use std::ops::Range;
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

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
        (Value::Array(items), Some(Value::Array(defaults))) => {
            let of_item = |(index, item)| as_number(key, item, element(defaults, index));
            Value::Array(items.into_iter().enumerate().map(of_item).collect())
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
        find_in(key, value, defaults.get(key), numbers);
    }
}

fn find_in(
    key: &str,
    value: &Spanned<DeValue<'_>>,
    default: Option<&Value>,
    numbers: &mut Vec<(Range<usize>, f64)>,
) {
    match (value.get_ref(), default) {
        (DeValue::Table(section), Some(Value::Table(defaults))) => find(section, defaults, numbers),
        (DeValue::Array(items), Some(Value::Array(defaults))) => {
            for (index, item) in items.iter().enumerate() {
                find_in(key, item, element(defaults, index), numbers);
            }
        }
        (DeValue::String(text), Some(Value::Float(_))) => {
            numbers.extend(length(key, text).map(|number| (value.span(), number)));
        }
        _ => {}
    }
}

/// The default of an array's element; one behind the default's end is like the last one.
fn element(defaults: &[Value], index: usize) -> Option<&Value> {
    defaults.get(index).or(defaults.last())
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
