//! `scand make-view`, which only the operator's page calls: it reads a model or a preview from its standard input and
//! writes a small form of it for browsers to its standard output, in a process that can open no file.

use super::confined::confine_filter;
use crate::evaluate::load::load_glb;
use crate::evaluate::picture::{self, Row};
use crate::evaluate::{DifferenceParameters, difference};
use crate::export::{Compression, compress};
use crate::image::{RgbImage, rgb_from_file, size_of_file};
use crate::output::encode_jpeg;
use crate::page::make_view::{DIFFERENCE, FORM, LARGEST_SOURCE, PARENT, View};
use crate::process::Limits;
use anyhow::Context;
use flate2::write::GzEncoder;
use std::io::{Read, Write};
use std::path::Path;
use std::process::ExitCode;

/// Make a small form of a model's file in a confined process. Only the page calls this.
#[derive(Debug, clap::Args)]
#[group(id = "make_view")]
pub struct Args {
    /// The process that started this one. When it ends, this one ends too.
    #[arg(long = PARENT, value_name = "PID")]
    parent: u32,
    /// What is made: model, thumbnail or difference.
    #[arg(long = FORM, value_name = "FORM")]
    form: String,
}

/// Memory that it may take, in megabytes: some times what the largest model has.
const MEMORY_MB: u32 = 400;
const NICE: u32 = 10;
/// Longest side of a thumbnail in pixels, and its quality.
const LONGEST: usize = 480;
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
    let mut source = Vec::new();
    let mut input = std::io::stdin().lock().take(LARGEST_SOURCE + 1);
    input.read_to_end(&mut source)?;
    anyhow::ensure!(
        source.len() as u64 <= LARGEST_SOURCE,
        "the file has more than {} MB",
        LARGEST_SOURCE >> 20
    );
    std::io::stdout()
        .lock()
        .write_all(&form_of(&args.form, &source)?)?;
    Ok(ExitCode::SUCCESS)
}

fn form_of(form: &str, source: &[u8]) -> anyhow::Result<Vec<u8>> {
    if form == DIFFERENCE {
        return difference_of(source);
    }
    let view = View::of_form(form);
    let view = view.with_context(|| {
        format!("{form:?} is not a form of a file, expected model, thumbnail or difference")
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
            Ok(encode_jpeg(&smaller(&picture), QUALITY)?)
        }
    }
}

/// The picture with at most [`LONGEST`] pixels a side: each pixel is the mean of those that it stands for.
fn smaller(picture: &RgbImage) -> RgbImage {
    let (width, height) = (picture.width(), picture.height());
    let longest = width.max(height);
    if longest <= LONGEST {
        return picture.clone();
    }
    let scaled = |side: usize| (side * LONGEST / longest).max(1);
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
        let small = smaller(&picture);
        assert_eq!((small.width(), small.height()), (480, 360));
        assert!(small.pixels().iter().all(|[r, ..]| (60..=140).contains(r)));
        let mean: u64 = small.pixels().iter().map(|[r, ..]| u64::from(*r)).sum();
        assert!((98..=102).contains(&(mean / (480 * 360))), "{mean}");
        let high = smaller(&RgbImage::filled(3, 5000, [1, 2, 3]));
        assert_eq!((high.width(), high.height()), (1, 480));
        assert_eq!(smaller(&RgbImage::filled(9, 9, [1, 2, 3])).width(), 9);
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
}
