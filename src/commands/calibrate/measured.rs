//! The options of a calibration that say what was measured by hand: the printed ruler, and distances of cameras.

use crate::calibration::fit::{CameraDistance, Length, MeasuredLengths, RulerReading};
use crate::frame::CameraId;
use crate::range;

/// Standard deviations of what is measured by hand, in metres: with a ruler, and between two cameras.
const RULER: f64 = 0.5e-3;
const DISTANCE: f64 = 15e-3;

/// Plain numbers of metres are below these: larger ones are most likely millimetres without their unit.
const LONGEST_RULER: f64 = 1.0;
const LONGEST_DISTANCE: f64 = 10.0;

#[derive(Debug, clap::Args)]
pub(super) struct MeasuredArgs {
    /// A length of the ruler that is printed on the board, and what you measured for it, such as 200mm=199.2mm or
    /// 200mm=199.2mm±0.3mm (or +-; 0.5 mm without): it shows whether the sheet was printed at full size
    #[arg(long, value_name = "PRINTED=MEASURED", value_parser = ruler)]
    measured: Vec<RulerReading>,
    /// The measured distance of two cameras' lenses, such as left right 1200mm±1mm (or +-; 15 mm without)
    #[arg(long, num_args = 3, value_names = ["CAMERA", "CAMERA", "LENGTH"])]
    distance: Vec<String>,
}

impl MeasuredArgs {
    /// All that was measured.
    ///
    /// # Errors
    /// If a distance names no camera or no length.
    pub(super) fn all(&self) -> anyhow::Result<MeasuredLengths> {
        let distances = self.distance.chunks_exact(3).map(|given| {
            let id =
                |name: &String| CameraId::new(name).map_err(|e| anyhow::anyhow!("--distance: {e}"));
            let measured = measured(&given[2], LONGEST_DISTANCE, DISTANCE);
            anyhow::ensure!(
                given[0] != given[1],
                "--distance names camera {} twice, expected two different cameras",
                given[0]
            );
            Ok(CameraDistance {
                cameras: [id(&given[0])?, id(&given[1])?],
                measured: measured.map_err(|e| anyhow::anyhow!("--distance: {e}"))?,
            })
        });
        Ok(MeasuredLengths {
            rulers: self.measured.clone(),
            distances: distances.collect::<anyhow::Result<_>>()?,
        })
    }
}

/// `200mm=199.2mm`.
fn ruler(text: &str) -> Result<RulerReading, String> {
    let (printed, read) = text
        .split_once('=')
        .ok_or_else(|| format!("{text:?} is not PRINTED=MEASURED, such as 200mm=199.2mm"))?;
    Ok(RulerReading {
        printed: length(printed, LONGEST_RULER)?,
        measured: measured(read, LONGEST_RULER, RULER)?,
    })
}

/// `1200mm±1mm`, `1200mm+-1mm` or `1200mm`.
fn measured(text: &str, longest: f64, usual: f64) -> Result<Length, String> {
    let Some((value, deviation)) = text.split_once('±').or_else(|| text.split_once("+-")) else {
        let metres = length(text, longest)?;
        return Ok(Length {
            metres,
            deviation: usual,
        });
    };
    let shown = deviation.trim();
    // ±0.3 after millimetres would be 0.3 metres, with which any length agrees.
    if range::has_unit(value) && !range::has_unit(deviation) {
        return Err(format!(
            "±{shown} has no unit, expected one as in 199.2mm±0.3mm"
        ));
    }
    let found = Length {
        metres: length(value, longest)?,
        deviation: length(deviation, longest)?,
    };
    match found.deviation < found.metres {
        true => Ok(found),
        false => Err(format!(
            "±{shown} is as large as what was measured, {}",
            value.trim()
        )),
    }
}

/// A length in metres: a number with its unit, or a plain number of metres that is below `longest`.
fn length(text: &str, longest: f64) -> Result<f64, String> {
    let text = text.trim();
    let possible =
        range::metres_below(longest, text).filter(|metres| *metres > 0.0 && *metres <= 1e3);
    possible.ok_or_else(|| {
        format!("{text:?} is not a length with its unit, such as 199.2mm (a plain number counts metres, below {longest})")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_measured_is_read_with_and_without_its_deviation() {
        let near = |found: Length, metres: f64, deviation: f64| {
            assert!((found.metres - metres).abs() < 1e-12, "{found:?}");
            assert!((found.deviation - deviation).abs() < 1e-12, "{found:?}");
        };
        near(
            measured("1200mm±1mm", LONGEST_DISTANCE, DISTANCE).unwrap(),
            1.2,
            0.001,
        );
        near(
            measured("1.2m +- 0.2cm", LONGEST_DISTANCE, DISTANCE).unwrap(),
            1.2,
            0.002,
        );
        near(
            measured("1.2", LONGEST_DISTANCE, DISTANCE).unwrap(),
            1.2,
            0.015,
        );
        for text in [
            "200mm=199.2mm",
            "0.2=0.1992",
            "20cm=199.2 mm",
            "20cm=19.92cm",
            " 200mm = 199.2mm ",
        ] {
            let reading = ruler(text).unwrap();
            assert!((reading.printed - 0.2).abs() < 1e-12);
            near(reading.measured, 0.1992, 0.0005);
        }
        for bad in [
            "200mm",
            "200=199.2",
            "200mm=-1mm",
            "200mm=199.2mm±",
            "0mm=1mm",
            "200mm=nanmm",
            "200mm=199,2mm",
            "200mm=199.2",
        ] {
            assert!(ruler(bad).is_err(), "{bad}");
        }
        for (bad, named) in [
            ("200mm=199.2mm±0.3", "±0.3 has no unit"),
            ("200mm=199.2mm +- 0.3", "±0.3 has no unit"),
            ("200mm=199.2mm±250mm", "±250mm is as large as"),
            ("0.2=0.1992±0.3", "±0.3 is as large as"),
        ] {
            let message = ruler(bad).unwrap_err();
            assert!(message.starts_with(named), "{message}");
        }
    }
}
