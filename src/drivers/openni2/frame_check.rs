//! Checks that a frame is complete; others are dropped. It calls no function of the library.

use super::ffi;
use std::ffi::c_int;

/// What a stream's frames must be like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ExpectedFrame {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// As the library numbers it.
    pub format: c_int,
    /// Bytes of a pixel.
    pub bytes_per_pixel: usize,
}

/// The rows of a complete frame, and the bytes from one's start to the next's.
///
/// # Errors
/// In words, if the frame is truncated, has another size or format, or is only part of a picture.
pub(super) fn complete_rows<'a>(
    expected: &ExpectedFrame,
    facts: &ffi::Frame,
    bytes: &'a [u8],
) -> Result<(u32, &'a [u8]), String> {
    let [width, height] = expected.size;
    if [facts.width, facts.height] != [width as c_int, height as c_int] {
        return Err(format!(
            "it has {} x {} pixels, expected {width} x {height}",
            facts.width, facts.height
        ));
    }
    if facts.cropping_enabled != 0 {
        return Err("it is only part of a picture".into());
    }
    let format = facts.video_mode.pixel_format;
    if format != expected.format {
        return Err(format!(
            "its pixels have OpenNI's format {format}, expected {}",
            expected.format
        ));
    }
    let row = width as usize * expected.bytes_per_pixel;
    let step = usize::try_from(facts.stride).unwrap_or(0);
    if step < row || step > 16 * row {
        return Err(format!(
            "its rows lie {} bytes apart, expected {row} or more",
            facts.stride
        ));
    }
    let needed = step * (height as usize - 1) + row;
    if bytes.len() < needed {
        return Err(format!(
            "only {} of its {needed} bytes arrived",
            bytes.len()
        ));
    }
    let end = bytes.len().min(step * height as usize);
    Ok((step as u32, &bytes[..end]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXPECTED: ExpectedFrame = ExpectedFrame {
        size: [4, 3],
        format: ffi::FORMAT_DEPTH_1_MM,
        bytes_per_pixel: 2,
    };

    fn facts() -> ffi::Frame {
        ffi::Frame {
            data_size: 24,
            data: std::ptr::null(),
            sensor_type: ffi::SENSOR_DEPTH,
            timestamp: 1,
            frame_index: 1,
            width: 4,
            height: 3,
            video_mode: ffi::VideoMode {
                pixel_format: ffi::FORMAT_DEPTH_1_MM,
                ..ffi::VideoMode::default()
            },
            cropping_enabled: 0,
            crop_origin_x: 0,
            crop_origin_y: 0,
            stride: 8,
        }
    }

    #[test]
    fn a_whole_frame_is_handed_on_with_its_rows_and_no_more() {
        assert_eq!(
            complete_rows(&EXPECTED, &facts(), &[7; 24]),
            Ok((8, &[7; 24][..]))
        );
        assert_eq!(
            complete_rows(&EXPECTED, &facts(), &[7; 99])
                .unwrap()
                .1
                .len(),
            24
        );
        let wide = ffi::Frame {
            stride: 10,
            ..facts()
        };
        assert_eq!(
            complete_rows(&EXPECTED, &wide, &[7; 28]).unwrap().1.len(),
            28
        );
    }

    #[test]
    fn anything_else_is_refused_in_words() {
        let cut = complete_rows(&EXPECTED, &facts(), &[7; 23]).unwrap_err();
        assert_eq!(cut, "only 23 of its 24 bytes arrived");
        let mut other = facts();
        other.height = 2;
        assert!(
            complete_rows(&EXPECTED, &other, &[7; 24])
                .unwrap_err()
                .contains("4 x 2")
        );
        let mut other = facts();
        other.cropping_enabled = 1;
        assert!(
            complete_rows(&EXPECTED, &other, &[7; 24])
                .unwrap_err()
                .contains("part")
        );
        let mut other = facts();
        other.video_mode.pixel_format = ffi::FORMAT_DEPTH_100_UM;
        assert!(
            complete_rows(&EXPECTED, &other, &[7; 24])
                .unwrap_err()
                .contains("101")
        );
        for stride in [-8, 0, 7, c_int::MAX] {
            let mut other = facts();
            other.stride = stride;
            let message = complete_rows(&EXPECTED, &other, &[7; 24]).unwrap_err();
            assert!(message.contains("apart"), "{message}");
        }
    }
}
