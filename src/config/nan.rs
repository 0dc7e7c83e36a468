//! Refuses settings that are NaN, which TOML allows. Every comparison with NaN is false, so a limit that is NaN
//! would limit nothing.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The first of a text that is TOML: its field, and the byte at which it stands.
pub(super) fn first(text: &str) -> Option<(String, usize)> {
    let table = DeTable::parse(text).ok()?;
    in_table(table.get_ref(), "")
}

fn in_table(table: &DeTable<'_>, path: &str) -> Option<(String, usize)> {
    let separator = if path.is_empty() { "" } else { "." };
    table.iter().find_map(|(key, value)| {
        let field = format!("{path}{separator}{}", key.get_ref());
        in_value(value, &field)
    })
}

fn in_value(value: &Spanned<DeValue<'_>>, field: &str) -> Option<(String, usize)> {
    match value.get_ref() {
        DeValue::Float(number) if number.as_str().ends_with("nan") => {
            Some((field.to_owned(), value.span().start))
        }
        DeValue::Array(values) => values.iter().find_map(|value| in_value(value, field)),
        DeValue::Table(table) => in_table(table, field),
        _ => None,
    }
}
