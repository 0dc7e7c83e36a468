//! Parses the numbers of configurations and refuses bad ones while the file is read, so that the message has their
//! line and field.

use serde::de::{Deserialize, Deserializer, Error, IntoDeserializer};

/// A length in metres, from a number with its unit (`2mm`, `0.2 cm`, `1in`, `500um`) or from a plain number of metres.
pub fn metres(text: &str) -> Option<f64> {
    let text = text.trim();
    let number = |number: &str, power: &str| {
        let number = number.trim();
        let is_plain = number
            .bytes()
            .all(|b| b.is_ascii_digit() || matches!(b, b'.' | b'-' | b'+'));
        // Scaled before it is read, so that 47.7 mm is the number nearest to 0.0477 m.
        format!("{number}{power}")
            .parse::<f64>()
            .ok()
            .filter(|_| is_plain)
    };
    if let Some(inches) = text.strip_suffix("in") {
        return number(inches, "").map(|inches| inches * 0.0254);
    }
    let units = [("um", "e-6"), ("mm", "e-3"), ("cm", "e-2"), ("m", "")];
    let unit = |(unit, power): (&str, &str)| number(text.strip_suffix(unit)?, power);
    let with_unit = units.into_iter().find_map(unit);
    let plain = || text.parse::<f64>().ok().filter(|metres| metres.is_finite());
    with_unit.or_else(plain)
}

/// The same of what is shorter than `most` metres: a longer one needs a unit, because a plain number is then most
/// likely one of millimetres.
pub fn metres_below(most: f64, text: &str) -> Option<f64> {
    metres(text).filter(|metres| has_unit(text) || metres.abs() < most)
}

/// Whether a length's text ends in a unit.
pub fn has_unit(text: &str) -> bool {
    text.trim_end().ends_with(|c: char| c.is_ascii_alphabetic())
}

/// A length in millimetres, from a number with its unit or from a plain number of millimetres.
///
/// # Errors
/// If the text is not a length: a message for the command line.
pub fn millimetres(text: &str) -> Result<f64, String> {
    let plain = text.trim().parse::<f64>().ok().filter(|mm| mm.is_finite());
    let with_unit = || metres(text).map(|metres| 1e3 * metres);
    plain
        .or_else(with_unit)
        .ok_or_else(|| "expected a length, such as 2mm, 0.1in or a number of millimetres".into())
}

/// A count from `LEAST` to `MOST`.
///
/// # Errors
/// If it is not such a value.
pub fn optional_count<'de, D: Deserializer<'de>, const LEAST: u32, const MOST: u32>(
    from: D,
) -> Result<Option<u32>, D::Error> {
    count::<D, u32, LEAST, MOST>(from).map(Some)
}

/// The same of a count that has a default, of any type that has room for it.
///
/// # Errors
/// If it is not such a value.
pub fn count<'de, D: Deserializer<'de>, T: TryFrom<i64>, const LEAST: u32, const MOST: u32>(
    from: D,
) -> Result<T, D::Error> {
    let found = i64::deserialize(from)?;
    let within = (i64::from(LEAST)..=i64::from(MOST)).contains(&found);
    let counted = T::try_from(found).ok().filter(|_| within);
    counted.ok_or_else(|| D::Error::custom(format!("{found}, expected {LEAST} to {MOST}")))
}

/// Width and height in pixels, each from 1 to 16384.
///
/// # Errors
/// If they are not.
pub fn optional_size<'de, D: Deserializer<'de>>(from: D) -> Result<Option<[u32; 2]>, D::Error> {
    // A fixed array would leave out what is too many.
    let found = Vec::<i64>::deserialize(from)?;
    match found[..] {
        [width @ 1..=16384, height @ 1..=16384] => Ok(Some([width as u32, height as u32])),
        _ => Err(D::Error::custom(format!(
            "{found:?}, expected a width and a height from 1 to 16384"
        ))),
    }
}

/// Seconds above 0, an hour's at most.
///
/// # Errors
/// If they are not, or no number.
pub fn optional_seconds<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    let found = f64::deserialize(from)?;
    let holds = found > 0.0 && found <= 3600.0;
    checked(found, holds, "seconds above 0 and up to 3600").map(Some)
}

/// Frames in a second, above 0 and up to 1000.
///
/// # Errors
/// If they are not, or no number.
pub fn optional_rate<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    let found = f64::deserialize(from)?;
    let holds = found > 0.0 && found <= 1000.0;
    checked(found, holds, "frames in a second above 0 and up to 1000").map(Some)
}

/// Milliseconds from 0 to an hour's.
///
/// # Errors
/// If they are not, or no number.
pub fn optional_milliseconds<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    milliseconds(from).map(Some)
}

/// Milliseconds from 1 to an hour's: of a patience, which without any time would always be over.
///
/// # Errors
/// If they are not, or no number.
pub fn optional_patience<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    let found = check(f64::deserialize(from)?, [1.0, 3.6e6], " milliseconds");
    found.map(Some).map_err(D::Error::custom)
}

/// Milliseconds from 0 to an hour's, of what has a default.
///
/// # Errors
/// If they are not, or no number.
pub fn milliseconds<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    check(f64::deserialize(from)?, [0.0, 3.6e6], " milliseconds").map_err(D::Error::custom)
}

/// Seconds from 0 to a day's.
///
/// # Errors
/// If they are not, or no number.
pub fn seconds_of_a_day<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    check(f64::deserialize(from)?, [0.0, 86_400.0], " seconds").map_err(D::Error::custom)
}

/// A number from `LEAST` to `MOST`, of any type that has room for it.
///
/// # Errors
/// If it is not such a value.
pub fn within<'de, D, T, const LEAST: i32, const MOST: i32>(from: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    between(from, LEAST.into(), MOST.into())
}

/// The same from 0.01.
///
/// # Errors
/// If it is not such a value.
pub fn at_least_a_hundredth<'de, D, T, const MOST: i32>(from: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    between(from, 1e-2, MOST.into())
}

/// The same from 0.001: of what would divide by 0.
///
/// # Errors
/// If it is not such a value.
pub fn from_a_thousandth<'de, D, T, const MOST: i32>(from: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    between(from, 1e-3, MOST.into())
}

/// The same from 0.000001.
///
/// # Errors
/// If it is not such a value.
pub fn at_least_a_millionth<'de, D, T, const MOST: i32>(from: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    between(from, 1e-6, MOST.into())
}

/// Whether a number lies from `least` to `most`, for those that come from elsewhere than a configuration.
///
/// # Errors
/// What was found and what was expected, in `unit`, which begins with a space unless it is empty.
pub fn check(found: f64, [least, most]: [f64; 2], unit: &str) -> Result<f64, OutOfRange> {
    // Not a number is in no range.
    if (least..=most).contains(&found) {
        return Ok(found);
    }
    Err(OutOfRange {
        found,
        expected: format!("{least} to {most}{unit}"),
    })
}

/// A number that is not within its range.
#[derive(Debug, thiserror::Error)]
#[error("the value is {found}, expected {expected}")]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub struct OutOfRange {
    pub found: f64,
    /// Its range, in words.
    pub expected: String,
}

fn between<'de, D, T>(from: D, least: f64, most: f64) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    let found = check(f64::deserialize(from)?, [least, most], "");
    T::deserialize(found.map_err(D::Error::custom)?.into_deserializer())
}

/// Two numbers, each from `LEAST` to `MOST`.
///
/// # Errors
/// If they are not.
pub fn each_within<'de, D, const LEAST: i32, const MOST: i32>(from: D) -> Result<[f64; 2], D::Error>
where
    D: Deserializer<'de>,
{
    let values = <[f64; 2]>::deserialize(from)?;
    for value in values {
        let holds = (f64::from(LEAST)..=f64::from(MOST)).contains(&value);
        checked(value, holds, &format!("two numbers from {LEAST} to {MOST}"))?;
    }
    Ok(values)
}

/// Any number but NaN and the infinities.
///
/// # Errors
/// If it is not.
pub fn optional_finite<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    let value = f64::deserialize(from)?;
    checked(value, value.is_finite(), "a finite number").map(Some)
}

/// A finite number above 0.
///
/// # Errors
/// If it is not.
pub fn optional_positive<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    let value = f64::deserialize(from)?;
    checked(value, is_positive(value), "a number above 0").map(Some)
}

/// Three finite numbers above 0.
///
/// # Errors
/// If they are not.
pub fn optional_three_positive<'de, D: Deserializer<'de>>(
    from: D,
) -> Result<Option<[f64; 3]>, D::Error> {
    let values = <[f64; 3]>::deserialize(from)?;
    for value in values {
        checked(value, is_positive(value), "three numbers above 0")?;
    }
    Ok(Some(values))
}

fn is_positive(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

fn checked<E: Error>(value: f64, holds: bool, expected: &str) -> Result<f64, E> {
    if holds {
        return Ok(value);
    }
    Err(E::custom(format!(
        "the value is {value}, expected {expected}"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_read_with_each_unit_and_without_one() {
        for (text, expected) in [
            ("2mm", Some(0.002)),
            (" 47.7 mm ", Some(0.0477)),
            ("0.2cm", Some(0.002)),
            ("1in", Some(0.0254)),
            ("500um", Some(0.0005)),
            ("1.5m", Some(1.5)),
            ("0.002", Some(0.002)),
            ("-3mm", Some(-0.003)),
            ("mm", None),
            ("2 furlongs", None),
            ("nan", None),
            ("1e3mm", None),
            ("", None),
        ] {
            assert_eq!(metres(text), expected, "{text}");
        }
        assert_eq!(metres_below(1.0, "0.025"), Some(0.025));
        assert_eq!(metres_below(1.0, "25"), None);
        assert_eq!(metres_below(1.0, "1200mm"), Some(1.2));
        assert_eq!([millimetres("2"), millimetres("0.2cm")], [Ok(2.0), Ok(2.0)]);
        assert!(millimetres("two").unwrap_err().contains("2mm"));
    }
}
