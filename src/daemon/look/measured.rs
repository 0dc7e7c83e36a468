//! What the last whole picture of each camera showed that a small one cannot: clipped pixels, sharpness, and how bright
//! pictures are as a capture has them. It is told with its own age. No picture is decoded here.

use crate::frame::{Picture, Timestamp};
use crate::trigger::LookFigures;
use std::collections::BTreeMap;

/// How long figures of a whole picture are told beside small ones.
const LASTS_NS: i128 = 20_000_000_000;
/// How much brighter one of two pictures may be whose background is the same.
const SAME_LIGHT: f64 = 1.25;
/// Mean below which it is too dark to tell, of 255.
const DARK: f64 = 8.0;
/// Each 61st byte is looked at: no common divisor with the rows' length, so that each colour of a Bayer pattern is met.
const STRIDE: usize = 61;
/// Why a small picture has no outline.
const NO_OUTLINE: &str =
    "the camera joins pixels for this picture, and it is not as bright as the whole one before it";

/// The figures of the last whole pictures.
#[derive(Default)]
pub(super) struct Measured(BTreeMap<String, Whole>);

struct Whole {
    time: Timestamp,
    brightness: Option<f64>,
    clipped_ppm: Option<u32>,
    sharpness_percent: Option<u32>,
}

impl Measured {
    /// Keeps the figures of a whole picture; adds them to those of a small one, which loses its outline if its light
    /// is not that of the background.
    pub(super) fn complete(
        &mut self,
        camera: &str,
        time: Timestamp,
        brightness: Option<f64>,
        seen: &mut LookFigures,
    ) {
        if !seen.is_binned {
            let whole = Whole {
                time,
                brightness,
                clipped_ppm: seen.clipped_ppm,
                sharpness_percent: seen.sharpness_percent,
            };
            self.0.insert(camera.to_owned(), whole);
            return;
        }
        let whole = self.0.get(camera);
        let whole = whole.filter(|w| (0..LASTS_NS).contains(&time.nanoseconds_since(w.time)));
        if seen.outline.is_some() && !whole.is_some_and(|w| is_same(w.brightness, brightness)) {
            (seen.outline, seen.touches) = (None, Vec::new());
            seen.no_outline = Some(NO_OUTLINE.into());
        }
        if let Some(whole) = whole {
            let before_ns = time.nanoseconds_since(whole.time);
            seen.measured_before_ms = u64::try_from(before_ns / 1_000_000).ok();
            seen.clipped_ppm = whole.clipped_ppm;
            seen.sharpness_percent = whole.sharpness_percent;
        }
    }
}

/// Mean of a sample of a picture's bytes, 0 to 255; `None` of a file.
pub(super) fn brightness(picture: &Picture) -> Option<f64> {
    let Picture::Raw { data, .. } = picture else {
        return None;
    };
    let sample = data.iter().step_by(STRIDE);
    let count = sample.clone().count();
    let sum: u64 = sample.map(|&byte| u64::from(byte)).sum();
    (count > 0).then(|| sum as f64 / count as f64)
}

/// Whether two pictures are surely of about the same brightness.
fn is_same(one: Option<f64>, other: Option<f64>) -> bool {
    let (Some(one), Some(other)) = (one, other) else {
        return false;
    };
    let (low, high) = (one.min(other), one.max(other));
    low >= DARK && high <= low * SAME_LIGHT
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small() -> LookFigures {
        LookFigures {
            is_binned: true,
            outline: Some(Vec::new()),
            touches: vec!["left".into()],
            ..LookFigures::default()
        }
    }

    #[test]
    fn a_small_picture_has_the_figures_of_the_whole_one_before_it_with_their_age() {
        let mut measured = Measured::default();
        let mut first = small();
        measured.complete("c00", Timestamp(5), Some(90.0), &mut first);
        assert_eq!((first.measured_before_ms, first.clipped_ppm), (None, None));
        assert!(first.outline.is_none() && first.no_outline.is_some());
        let mut whole = LookFigures {
            clipped_ppm: Some(7),
            sharpness_percent: Some(60),
            ..LookFigures::default()
        };
        let unchanged = whole.clone();
        measured.complete("c00", Timestamp(1_000_000_000), Some(100.0), &mut whole);
        assert_eq!(whole, unchanged);
        let later = Timestamp(1_700_000_000);
        let mut second = small();
        measured.complete("c00", later, Some(110.0), &mut second);
        assert_eq!(second.measured_before_ms, Some(700));
        assert_eq!(
            (second.clipped_ppm, second.sharpness_percent),
            (Some(7), Some(60))
        );
        assert_eq!(second.touches, ["left"]);
        // Of another camera, and of long ago, nothing is known.
        for (camera, time) in [("c01", later), ("c00", Timestamp(30_000_000_000))] {
            let mut other = small();
            measured.complete(camera, time, Some(100.0), &mut other);
            assert_eq!((other.measured_before_ms, other.clipped_ppm), (None, None));
            assert!(other.outline.is_none());
        }
    }

    #[test]
    fn a_small_picture_of_another_brightness_has_no_outline() {
        let cases = [
            (Some(100.0), Some(80.0), true),
            (Some(60.0), Some(240.0), false),
            (Some(2.0), Some(2.0), false),
            (None, Some(100.0), false),
        ];
        for (one, other, same) in cases {
            assert_eq!(is_same(one, other), same, "{one:?} {other:?}");
        }
        let mut measured = Measured::default();
        let mut whole = LookFigures::default();
        measured.complete("c00", Timestamp(0), Some(60.0), &mut whole);
        let mut small = small();
        measured.complete("c00", Timestamp(1_000_000), Some(240.0), &mut small);
        assert!(small.outline.is_none() && small.touches.is_empty());
        assert_eq!(small.no_outline.as_deref(), Some(NO_OUTLINE));
        assert_eq!(small.measured_before_ms, Some(1));
    }

    #[test]
    fn brightness_is_a_mean_of_bytes() {
        let picture = |data: Vec<u8>| Picture::Raw {
            width: 640,
            height: 1,
            encoding: "mono8".into(),
            step: 640,
            data: data.into(),
        };
        assert_eq!(brightness(&picture(vec![7; 640])), Some(7.0));
        assert_eq!(brightness(&picture(Vec::new())), None);
    }
}
