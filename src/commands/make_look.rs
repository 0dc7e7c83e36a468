//! `scand make-look`, which only the daemon calls: it reads a camera's frame from its standard input and writes a small
//! picture of it, and what is seen in it, to its standard output, in a process that can open no file.

use super::confined::confine_filter;
use super::picture_limit::checked;
use crate::calibration::RigCalibration;
use crate::daemon::look::protocol::{Head, LARGEST_INPUT, PARENT, Pixels, SegmentationSettings};
use crate::frame::CameraId;
use crate::image::{
    RawPixels, RgbImage, readings_from_raw, rgb_from_file, rgb_from_raw, size_of_file,
};
use crate::look::{self, Segmentation};
use crate::output::encode_jpeg;
use crate::process::Limits;
use crate::trigger::LookFigures;
use anyhow::Context;
use std::io::{BufRead, Read, Write};
use std::path::Path;
use std::process::ExitCode;

/// Make a look's picture of a frame in a confined process. Only the daemon calls this.
#[derive(Debug, clap::Args)]
#[group(id = "make_look")]
pub struct Args {
    /// The process that started this one. When it ends, this one ends too.
    #[arg(long = PARENT, value_name = "PID")]
    parent: u32,
}

/// Memory that it may take, in megabytes: a frame and a background of the most pixels, encoded and as colours.
const MEMORY_MB: u32 = 500;
const NICE: u32 = 19;
/// Longest first line of the input in bytes.
const LONGEST_HEAD: u64 = 4 << 20;
/// Quality of the picture: for a look, not for a model.
const QUALITY: u8 = 80;

/// Confines this process, and turns its input into its output.
///
/// # Errors
/// If it cannot be confined, or the input is not what the daemon writes.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let limits = Limits {
        memory_mb: MEMORY_MB,
        nice: NICE,
    };
    confine_filter(args.parent, limits)?;
    let made = made(std::io::stdin().lock())?;
    std::io::stdout().lock().write_all(&made)?;
    Ok(ExitCode::SUCCESS)
}

/// The output for an input.
fn made(mut input: impl BufRead) -> anyhow::Result<Vec<u8>> {
    let mut line = Vec::new();
    input
        .by_ref()
        .take(LONGEST_HEAD)
        .read_until(b'\n', &mut line)?;
    let head: Head =
        serde_json::from_slice(&line).context("cannot parse the request's first line")?;
    let mut bytes = |pixels: &Pixels| -> anyhow::Result<Vec<u8>> {
        anyhow::ensure!(
            pixels.bytes <= LARGEST_INPUT,
            "the picture has {} bytes, expected at most {LARGEST_INPUT}",
            pixels.bytes
        );
        let mut bytes = vec![0; pixels.bytes as usize];
        input.read_exact(&mut bytes)?;
        Ok(bytes)
    };
    let frame = bytes(&head.frame)?;
    let (seen, picture) = if head.depth {
        depth(&head.frame, &frame)?
    } else {
        let picture = decoded(&head.frame, &frame).context("cannot decode the frame")?;
        drop(frame);
        let background = match &head.background {
            Some(background) => {
                let encoded = bytes(background)?;
                let decoded = decoded(background, &encoded);
                Some(decoded.context("cannot decode the background")?)
            }
            None => None,
        };
        let cutting = cutting(&head, background)?;
        match head.joined {
            1 => color(&picture, cutting),
            2 => binned(&picture, 2, cutting),
            joined => anyhow::bail!("{joined} pixels are joined, expected 1 or 2"),
        }
    };
    let mut output = serde_json::to_vec(&seen)?;
    output.push(b'\n');
    output.extend(encode_jpeg(&picture, QUALITY)?);
    Ok(output)
}

fn color(picture: &RgbImage, cutting: Result<Segmentation, String>) -> (LookFigures, RgbImage) {
    let look = look::color(picture, cutting.as_ref().map_err(Clone::clone));
    let (outline, touches, no_outline) = match look.outline {
        Ok(outline) => (Some(outline.polygons), outline.touches, None),
        Err(words) => (None, Vec::new(), Some(words)),
    };
    let seen = LookFigures {
        clipped_ppm: Some(look.clipped_ppm),
        clipped: look.clipped,
        sharpness_percent: look.sharpness_percent,
        outline,
        touches: touches.into_iter().map(Into::into).collect(),
        no_outline,
        ..of_size(&look.picture, look.scale)
    };
    (seen, look.picture)
}

/// What a picture shows for which the camera joined pixels: neither clipped ones nor sharpness as a capture has them.
fn binned(
    picture: &RgbImage,
    joined: usize,
    cutting: Result<Segmentation, String>,
) -> (LookFigures, RgbImage) {
    let look = look::binned(picture, joined, cutting.as_ref().map_err(Clone::clone));
    let (outline, touches, no_outline) = match look.outline {
        Ok(outline) => (Some(outline.polygons), outline.touches, None),
        Err(words) => (None, Vec::new(), Some(words)),
    };
    let seen = LookFigures {
        is_binned: true,
        outline,
        touches: touches.into_iter().map(Into::into).collect(),
        no_outline,
        ..of_size(&look.picture, look.scale)
    };
    (seen, look.picture)
}

fn depth(pixels: &Pixels, frame: &[u8]) -> anyhow::Result<(LookFigures, RgbImage)> {
    let readings = readings_from_raw(&raw(pixels, frame), size(pixels)?)?;
    let (picture, percent) = look::depth(&readings);
    let scale = readings.width() / picture.width();
    let seen = LookFigures {
        readings_percent: Some(percent),
        ..of_size(&picture, scale)
    };
    Ok((seen, picture))
}

fn of_size(picture: &RgbImage, scale: usize) -> LookFigures {
    LookFigures {
        width: picture.width() as u32,
        height: picture.height() as u32,
        scale: scale as u32,
        ..LookFigures::default()
    }
}

/// What the object is cut out with, or why it cannot be.
fn cutting(
    head: &Head,
    background: Option<RgbImage>,
) -> anyhow::Result<Result<Segmentation, String>> {
    let Some(settings) = &head.cutting else {
        return Ok(Err("the rig is not calibrated".into()));
    };
    let Some(background) = background else {
        return Ok(Err(
            "there is no background picture: take background pictures of the empty rig".into(),
        ));
    };
    let SegmentationSettings {
        calibration,
        silhouette,
    } = settings;
    let calibration = RigCalibration::parse(Path::new("of the rig"), calibration)?;
    let id = CameraId::new(&head.camera)?;
    let (Some((camera, _)), Some(volume)) = (calibration.cameras.get(&id), calibration.volume)
    else {
        return Ok(Err("the camera is not calibrated".into()));
    };
    Ok(Ok(Segmentation {
        camera: camera.clone(),
        volume,
        background,
        parameters: serde_json::from_value(silhouette.clone())
            .context("cannot read the silhouette settings")?,
    }))
}

fn raw<'a>(pixels: &'a Pixels, data: &'a [u8]) -> RawPixels<'a> {
    RawPixels {
        width: pixels.width as usize,
        height: pixels.height as usize,
        encoding: &pixels.encoding,
        step: pixels.step as usize,
        data,
    }
}

fn size(pixels: &Pixels) -> anyhow::Result<(usize, usize)> {
    checked((pixels.width as usize, pixels.height as usize))
}

fn decoded(pixels: &Pixels, data: &[u8]) -> anyhow::Result<RgbImage> {
    if pixels.step > 0 {
        return Ok(rgb_from_raw(&raw(pixels, data), size(pixels)?)?);
    }
    let size = checked(size_of_file(&pixels.encoding, data)?)?;
    Ok(rgb_from_file(&pixels.encoding, data, size)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input(head: &Head, pixels: &[u8]) -> Vec<u8> {
        let mut bytes = serde_json::to_vec(head).unwrap();
        bytes.push(b'\n');
        bytes.extend_from_slice(pixels);
        bytes
    }

    fn head(depth: bool, encoding: &str, step: u32, bytes: u64) -> Head {
        Head {
            camera: "c00".into(),
            depth,
            joined: 1,
            frame: Pixels {
                width: 64,
                height: 48,
                encoding: encoding.into(),
                step,
                bytes,
            },
            background: None,
            cutting: None,
        }
    }

    fn seen_of(output: &[u8]) -> (LookFigures, (usize, usize)) {
        let end = output.iter().position(|&byte| byte == b'\n').unwrap();
        let picture = &output[end + 1..];
        let size = size_of_file("jpeg", picture).unwrap();
        (serde_json::from_slice(&output[..end]).unwrap(), size)
    }

    #[test]
    fn raw_frames_files_and_depth_become_small_pictures() {
        let bright = vec![255; 64 * 48];
        let made_of = |head: &Head, pixels: &[u8]| made(&input(head, pixels)[..]).unwrap();
        let (seen, size) = seen_of(&made_of(&head(false, "bayer_rggb8", 64, 64 * 48), &bright));
        assert_eq!((seen.clipped_ppm, size), (Some(1_000_000), (64, 48)));
        assert_eq!(seen.no_outline.unwrap(), "the rig is not calibrated");
        let file = encode_jpeg(&RgbImage::filled(1300, 100, [90, 90, 90]), 90).unwrap();
        let (seen, size) = seen_of(&made_of(&head(false, "jpeg", 0, file.len() as u64), &file));
        assert_eq!((seen.scale, size), (3, (433, 33)));
        let readings: Vec<u8> = (0..64 * 48).flat_map(|_| 700_u16.to_le_bytes()).collect();
        let (seen, _) = seen_of(&made_of(&head(true, "16UC1", 128, 64 * 48 * 2), &readings));
        assert_eq!((seen.readings_percent, seen.clipped_ppm), (Some(100), None));
    }

    #[test]
    fn a_binned_frame_shows_neither_clipped_pixels_nor_sharpness() {
        let bright = vec![255; 64 * 48];
        let head = Head {
            joined: 2,
            ..head(false, "bayer_rggb8", 64, 64 * 48)
        };
        let (seen, size) = seen_of(&made(&input(&head, &bright)[..]).unwrap());
        assert_eq!((size, seen.scale, seen.is_binned), ((64, 48), 2, true));
        assert_eq!((seen.clipped_ppm, seen.sharpness_percent), (None, None));
        assert!(seen.clipped.is_empty() && seen.no_outline.is_some());
    }

    #[test]
    fn what_is_no_frame_is_refused() {
        for (head, pixels) in [
            (head(false, "bayer_rggb8", 64, 64 * 48), &[0; 10][..]),
            (head(false, "bayer_rggb8", 10, 10), &[0; 10][..]),
            (head(false, "jpeg", 0, 10), &[0xff; 10][..]),
            (head(true, "mono8", 64, 10), &[0; 10][..]),
            (head(false, "mono8", 64, u64::MAX), &[][..]),
            (
                Head {
                    joined: 3,
                    ..head(false, "mono8", 64, 64 * 48)
                },
                &[0; 64 * 48][..],
            ),
        ] {
            assert!(made(&input(&head, pixels)[..]).is_err(), "{head:?}");
        }
        assert!(made(&b"no line"[..]).is_err());
    }
}
