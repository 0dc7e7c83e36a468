//! `scand make-view`, which only the operator's page calls: it reads a model, a preview or a recording from its
//! standard input and writes a small form of it for browsers to its standard output. It can open no file.

use super::confined::confine_filter;
use super::photographs::{decoded, pictures_of};
use crate::evaluate::load::load_glb;
use crate::evaluate::picture::{self, Row};
use crate::evaluate::{DifferenceParameters, difference};
use crate::export::{Compression, compress};
use crate::frame::CameraId;
use crate::image::{RgbImage, rgb_from_file, size_of_file};
use crate::output::encode_jpeg;
use crate::page::make_view::{
    CAMERA, CAPTURE, DIFFERENCE, FORM, LARGEST_SOURCE, PARENT, PHOTOGRAPHS, RECORDING, View,
};
use crate::process::Limits;
use crate::recording::Recording;
use anyhow::Context;
use flate2::write::GzEncoder;
use serde_json::json;
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::path::Path;
use std::process::ExitCode;

/// Make a small form of a model's file in a confined process. Only the page calls this.
#[derive(Debug, clap::Args)]
#[group(id = "make_view")]
pub struct Args {
    /// The process that started this one. When it ends, this one ends too.
    #[arg(long = PARENT, value_name = "PID")]
    parent: u32,
    /// What is made: model, thumbnail, difference or photographs.
    #[arg(long = FORM, value_name = "FORM")]
    form: String,
    /// The name of the recording's file, for photographs.
    #[arg(long = RECORDING, value_name = "FILE", default_value = "")]
    recording: String,
    /// The capture, for photographs.
    #[arg(long = CAPTURE, value_name = "ID", default_value = "")]
    capture: String,
    /// The one camera whose photograph is wanted, in a size that shows whether it is sharp.
    #[arg(long = CAMERA, value_name = "ID")]
    camera: Option<String>,
}

/// Memory that it may take, in megabytes: some times what the largest model has.
const MEMORY_MB: u32 = 400;
const NICE: u32 = 10;
/// Longest side of a thumbnail in pixels, of a photograph among others, and of one alone; and their quality.
const LONGEST: usize = 480;
const LONGEST_OF_MANY: usize = 320;
const LONGEST_ALONE: usize = 2048;
const QUALITY: u8 = 82;
/// Points on each of two surfaces that are compared, beside their vertices.
const SAMPLES: usize = 20_000;
/// Most pixels of a preview.
const MOST_PIXELS: usize = 40_000_000;

/// Confines this process, and turns its input into its output.
///
/// # Errors
/// If it cannot be confined, or the input is not what was asked for.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let limits = Limits {
        memory_mb: MEMORY_MB,
        nice: NICE,
    };
    confine_filter(args.parent, limits)?;
    let made = if args.form == PHOTOGRAPHS {
        // A recording may be larger than memory: of it only what is wanted is read.
        let input = std::io::stdin().as_fd().try_clone_to_owned()?;
        photographs(File::from(input), &args)?
    } else {
        form_of(&args.form, &whole_input()?)?
    };
    std::io::stdout().lock().write_all(&made)?;
    Ok(ExitCode::SUCCESS)
}

fn whole_input() -> anyhow::Result<Vec<u8>> {
    let mut source = Vec::new();
    let mut input = std::io::stdin().lock().take(LARGEST_SOURCE + 1);
    input.read_to_end(&mut source)?;
    anyhow::ensure!(
        source.len() as u64 <= LARGEST_SOURCE,
        "the file has more than {} MB",
        LARGEST_SOURCE >> 20
    );
    Ok(source)
}

/// One camera's photograph of a capture; or those of all cameras: a line of JSON that has for each camera its picture's
/// size in pixels and in bytes, or why there is none, and the pictures behind it.
fn photographs(file: File, args: &Args) -> anyhow::Result<Vec<u8>> {
    let recording = Recording::of_file(file, Path::new(&args.recording))?;
    let found = pictures_of(&recording, &args.capture);
    if let Some(camera) = &args.camera {
        let id = CameraId::new(camera)?;
        let message = found
            .get(&id)
            .with_context(|| format!("{}: {id} has no picture in it", args.capture))?;
        let picture = decoded(&recording, &id, message)?;
        return Ok(encode_jpeg(&smaller(&picture, LONGEST_ALONE), QUALITY)?);
    }
    let (mut list, mut pictures) = (Vec::new(), Vec::new());
    for (id, message) in &found {
        let made = decoded(&recording, id, message).and_then(|picture| {
            let small = smaller(&picture, LONGEST_OF_MANY);
            let bytes = encode_jpeg(&small, QUALITY)?;
            Ok((small.width(), small.height(), bytes))
        });
        list.push(match made {
            Ok((width, height, bytes)) => {
                let length = bytes.len();
                pictures.extend(bytes);
                json!({ "camera": id.as_str(), "width": width, "height": height, "bytes": length })
            }
            Err(error) => json!({ "camera": id.as_str(), "words": format!("{error:#}") }),
        });
    }
    let mut output = serde_json::to_vec(&list)?;
    output.push(b'\n');
    output.extend(pictures);
    Ok(output)
}

fn form_of(form: &str, source: &[u8]) -> anyhow::Result<Vec<u8>> {
    if form == DIFFERENCE {
        return difference_of(source);
    }
    let view = View::of_form(form);
    let view = view.with_context(|| {
        format!(
            "{form:?} is not a form of a file, expected model, thumbnail, difference or photographs"
        )
    })?;
    view_of(view, source)
}

/// How far two models are apart, as a line of JSON and a picture.
fn difference_of(source: &[u8]) -> anyhow::Result<Vec<u8>> {
    let (length, both) = source
        .split_first_chunk()
        .context("the input ends before the first model's length")?;
    let length = usize::try_from(u64::from_le_bytes(*length))?;
    let (a, b) = both
        .split_at_checked(length)
        .context("the first model is cut off")?;
    let a = load_glb(a, Path::new("the model"))?;
    let b = load_glb(b, Path::new("the other model"))?;
    let parameters = DifferenceParameters {
        samples: SAMPLES,
        ..DifferenceParameters::default()
    };
    let found = difference(&a, &b, &parameters)?;
    let rows = [(&a, &b, "this model"), (&b, &a, "the other")].map(|(one, other, title)| {
        (
            title,
            &one.mesh,
            picture::vertex_distances(&one.mesh, &other.mesh),
        )
    });
    let rows = rows.each_ref().map(|row| Row {
        title: row.0,
        mesh: row.1,
        signed_mm: &row.2,
    });
    let picture = picture::draw("distance to the other surface", &rows);
    let mut output = serde_json::to_vec(&found)?;
    output.push(b'\n');
    output.extend(encode_jpeg(&picture, QUALITY)?);
    Ok(output)
}

fn view_of(view: View, source: &[u8]) -> anyhow::Result<Vec<u8>> {
    match view {
        View::Model => {
            let small = compress(source, Compression::Quantization).map_err(anyhow::Error::msg)?;
            let mut encoder = GzEncoder::new(Vec::new(), flate2::Compression::default());
            encoder.write_all(&small)?;
            Ok(encoder.finish()?)
        }
        View::Thumbnail => {
            let (width, height) = size_of_file("png", source)?;
            anyhow::ensure!(
                width.saturating_mul(height) <= MOST_PIXELS,
                "the preview has {width}x{height} pixels"
            );
            let picture = rgb_from_file("png", source, (width, height))?;
            Ok(encode_jpeg(&smaller(&picture, LONGEST), QUALITY)?)
        }
    }
}

/// The picture with at most so many pixels a side: each pixel is the mean of those that it stands for.
fn smaller(picture: &RgbImage, most: usize) -> RgbImage {
    let (width, height) = (picture.width(), picture.height());
    let longest = width.max(height);
    if longest <= most {
        return picture.clone();
    }
    let scaled = |side: usize| (side * most / longest).max(1);
    let (columns, rows) = (scaled(width), scaled(height));
    RgbImage::from_fn(columns, rows, |x, y| {
        let across = x * width / columns..((x + 1) * width / columns);
        let down = y * height / rows..((y + 1) * height / rows);
        let count = (across.len() * down.len()).max(1) as u32;
        let pixels = down.flat_map(|row| &picture.row(row)[across.clone()]);
        let sums = pixels.fold([0_u32; 3], |sums, pixel| {
            [0, 1, 2].map(|channel| sums[channel] + u32::from(pixel[channel]))
        });
        sums.map(|sum| ((sum + count / 2) / count) as u8)
    })
}

#[cfg(test)]
mod tests {
    use super::super::photographs::tests::record;
    use super::*;

    #[test]
    fn a_thumbnail_is_small_and_has_the_means_of_the_picture() {
        let picture = RgbImage::from_fn(1200, 900, |x, _| {
            if x % 2 == 0 {
                [0, 0, 0]
            } else {
                [200, 100, 50]
            }
        });
        let small = smaller(&picture, LONGEST);
        assert_eq!((small.width(), small.height()), (480, 360));
        assert!(small.pixels().iter().all(|[r, ..]| (60..=140).contains(r)));
        let mean: u64 = small.pixels().iter().map(|[r, ..]| u64::from(*r)).sum();
        assert!((98..=102).contains(&(mean / (480 * 360))), "{mean}");
        let high = smaller(&RgbImage::filled(3, 5000, [1, 2, 3]), LONGEST);
        assert_eq!((high.width(), high.height()), (1, 480));
        let low = RgbImage::filled(9, 9, [1, 2, 3]);
        assert_eq!(smaller(&low, LONGEST).width(), 9);
    }

    #[test]
    fn what_is_no_model_and_no_picture_is_refused() {
        for bytes in [&b""[..], b"glTF", b"\x89PNG\r\n\x1a\n", &[0xff; 300]] {
            assert!(view_of(View::Model, bytes).is_err());
            assert!(view_of(View::Thumbnail, bytes).is_err());
            assert!(form_of(DIFFERENCE, bytes).is_err());
            assert!(form_of("other", bytes).is_err());
        }
    }

    #[test]
    fn photographs_of_a_capture_are_told_in_a_line_and_one_alone_is_larger() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        record(&path);
        let made = |capture: &str, camera: Option<&str>| {
            let args = Args {
                parent: 1,
                form: PHOTOGRAPHS.into(),
                recording: "a.mcap".into(),
                capture: capture.into(),
                camera: camera.map(Into::into),
            };
            photographs(File::open(&path).unwrap(), &args)
        };
        let output = made("a-2", None).unwrap();
        let end = output.iter().position(|&byte| byte == b'\n').unwrap();
        let list: serde_json::Value = serde_json::from_slice(&output[..end]).unwrap();
        assert_eq!(list[0]["camera"], "c00");
        assert_eq!(
            (&list[0]["width"], &list[0]["height"]),
            (&json!(320), &json!(240))
        );
        assert!(
            list[2]["words"].as_str().unwrap().contains("jpeg"),
            "{list}"
        );
        let length = |n: usize| list[n]["bytes"].as_u64().unwrap() as usize;
        assert_eq!(output.len(), end + 1 + length(0) + length(1));
        let first = &output[end + 1..end + 1 + length(0)];
        assert_eq!(size_of_file("jpeg", first).unwrap(), (320, 240));
        let alone = made("a-2", Some("c00")).unwrap();
        assert_eq!(size_of_file("jpeg", &alone).unwrap(), (640, 480));
        assert_eq!(made("a-3", None).unwrap(), b"[]\n");
        for (capture, camera) in [
            ("a-3", "c00"),
            ("a-1", "c07"),
            ("a-1", "c02"),
            ("a-1", "../x"),
        ] {
            made(capture, Some(camera)).unwrap_err();
        }
    }

    #[test]
    fn what_is_no_recording_has_no_photographs() {
        let args = Args {
            parent: 1,
            form: PHOTOGRAPHS.into(),
            recording: "a.mcap.part".into(),
            capture: "a-1".into(),
            camera: None,
        };
        let mut file = tempfile::tempfile().unwrap();
        photographs(file.try_clone().unwrap(), &args).unwrap_err();
        file.write_all(&[7; 5000]).unwrap();
        photographs(file, &args).unwrap_err();
    }
}
