//! Decides whether the frame in a filled buffer is complete, and when its exposure began. It makes no system call.

use super::jpeg::{self, Jpeg};
use crate::drivers::pixel_format::PixelFormat;
use std::time::Duration;

/// The kernel's flags of a buffer.
pub(super) const FLAG_ERROR: u32 = 0x0040;
const FLAG_CLOCK_MASK: u32 = 0xe000;
const FLAG_CLOCK_MONOTONIC: u32 = 0x2000;
const FLAG_MARK_MASK: u32 = 0x0007_0000;
const FLAG_MARK_START_OF_EXPOSURE: u32 = 0x0001_0000;

/// What a camera's frames have to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ExpectedFrame {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// How its pixels come.
    pub format: PixelFormat,
    /// Bytes from one row's start to the next's; 0 where frames are compressed.
    pub stride: u32,
    /// Its exposure in seconds, where it is known.
    pub exposure: Option<f64>,
    /// From the end of the exposure to the last line, in seconds.
    pub readout: f64,
}

/// A whole frame: how many of its bytes count, and where its tables belong if it is a JPEG.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WholeFrame {
    /// Rows of pixels.
    Rows(usize),
    /// A picture file.
    File(Jpeg),
}

/// Judges a buffer by its flags and what was filled in.
///
/// # Errors
/// In words, if it is damaged.
pub(super) fn whole(
    expected: &ExpectedFrame,
    flags: u32,
    bytes: &[u8],
) -> Result<WholeFrame, String> {
    if flags & FLAG_ERROR != 0 {
        return Err("the driver reports that it is damaged".into());
    }
    let Some(per_pixel) = expected.format.bytes_per_pixel() else {
        return jpeg::inspect(bytes).map(WholeFrame::File);
    };
    let [width, height] = expected.size.map(|n| n as usize);
    let stride = expected.stride as usize;
    let needed = stride * height.saturating_sub(1) + width * per_pixel;
    if bytes.len() < needed {
        return Err(format!(
            "only {} of its {needed} bytes arrived",
            bytes.len()
        ));
    }
    Ok(WholeFrame::Rows(bytes.len().min(stride * height)))
}

/// The start of a frame's exposure by the monotonic clock; `None` where its time is not of that clock.
pub(super) fn exposed(expected: &ExpectedFrame, flags: u32, time: Duration) -> Option<Duration> {
    if flags & FLAG_CLOCK_MASK != FLAG_CLOCK_MONOTONIC {
        return None;
    }
    if flags & FLAG_MARK_MASK == FLAG_MARK_START_OF_EXPOSURE {
        return Some(time);
    }
    Some(time.saturating_sub(age(expected)))
}

/// How old a frame is when its last line is there.
pub(super) fn age(expected: &ExpectedFrame) -> Duration {
    let seconds = expected.exposure.unwrap_or(0.0) + expected.readout;
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXPECTED: ExpectedFrame = ExpectedFrame {
        size: [4, 3],
        format: PixelFormat::Yuyv,
        stride: 10,
        exposure: Some(0.01),
        readout: 0.02,
    };

    #[test]
    fn a_buffer_that_is_short_or_marked_is_damaged() {
        assert_eq!(whole(&EXPECTED, 0, &[1; 28]), Ok(WholeFrame::Rows(28)));
        assert_eq!(whole(&EXPECTED, 0, &[1; 99]), Ok(WholeFrame::Rows(30)));
        let short = whole(&EXPECTED, 0, &[1; 27]).unwrap_err();
        assert_eq!(short, "only 27 of its 28 bytes arrived");
        assert!(
            whole(&EXPECTED, FLAG_ERROR, &[1; 30])
                .unwrap_err()
                .contains("driver")
        );
        let jpeg = ExpectedFrame {
            format: PixelFormat::Mjpeg,
            ..EXPECTED
        };
        assert!(whole(&jpeg, 0, &[0; 100]).is_err());
        let bayer = ExpectedFrame {
            format: PixelFormat::BayerGrbg8,
            stride: 4,
            ..EXPECTED
        };
        assert_eq!(whole(&bayer, 0, &[1; 12]), Ok(WholeFrame::Rows(12)));
    }

    #[test]
    fn a_time_is_mapped_to_the_start_of_the_exposure() {
        let time = Duration::from_millis(5000);
        let start = FLAG_CLOCK_MONOTONIC | FLAG_MARK_START_OF_EXPOSURE;
        assert_eq!(exposed(&EXPECTED, start, time), Some(time));
        let end = exposed(&EXPECTED, FLAG_CLOCK_MONOTONIC, time);
        assert_eq!(end, Some(Duration::from_millis(4970)));
        assert_eq!(exposed(&EXPECTED, 0, time), None);
        assert_eq!(exposed(&EXPECTED, 0x4000, time), None);
    }
}
