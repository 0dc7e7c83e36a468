//! A colour camera's sensor: photons and read noise behind a Bayer mosaic, the sRGB curve, and the encodings in
//! which a camera delivers its pictures.

use super::options::{ColorSensor, Encoding};
use super::random::Random;
use super::render::{Light3, Rendered};
use bytes::Bytes;
use image::ExtendedColorType;
use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use scand_core::frame::Picture;
use scand_core::image::Grid;
use std::sync::LazyLock;

/// Exposes a rendered scene: `gains` multiply red, green and blue, `key` is what the noise derives from.
pub(super) fn expose(
    rendered: &Rendered,
    sensor: &ColorSensor,
    gains: Light3,
    key: [u64; 4],
) -> Picture {
    let (width, height) = rendered.size();
    let raw = |encoding: &str, bytes_per_pixel: usize, data: Vec<u8>| Picture::Raw {
        width: width as u32,
        height: height as u32,
        encoding: encoding.to_owned(),
        step: (width * bytes_per_pixel) as u32,
        data: data.into(),
    };
    let grey = |light: Grid<f32>| light.pixels().iter().map(|&l| srgb(l)).collect();
    match sensor.encoding {
        Encoding::Bayer => {
            let light = mosaic(rendered, sensor, gains, key);
            raw("bayer_rggb8", 1, grey(light))
        }
        Encoding::Mono => {
            let light = sensed(rendered, sensor, key, |light, _, _| {
                (light[0] * gains[0] + 2.0 * light[1] * gains[1] + light[2] * gains[2]) * 0.25
            });
            raw("mono8", 1, grey(light))
        }
        Encoding::Rgb => raw("rgb8", 3, developed(rendered, sensor, gains, key)),
        Encoding::Jpeg => {
            let rgb = developed(rendered, sensor, gains, key);
            let mut data = Vec::new();
            let mut encoder = Encoder::new(&mut data, sensor.jpeg_quality);
            encoder.set_sampling_factor(SamplingFactor::R_4_4_4);
            let size = u16::try_from(width).ok().zip(u16::try_from(height).ok());
            let is_complete =
                size.is_some_and(|(w, h)| encoder.encode(&rgb, w, h, ColorType::Rgb).is_ok());
            compressed("jpeg", is_complete, data)
        }
        Encoding::Png => {
            let rgb = developed(rendered, sensor, gains, key);
            let mut data = Vec::new();
            let encoder =
                PngEncoder::new_with_quality(&mut data, CompressionType::Fast, FilterType::Up);
            let (w, h) = (width as u32, height as u32);
            let written = encoder.write_image(&rgb, w, h, ExtendedColorType::Rgb8);
            compressed("png", written.is_ok(), data)
        }
    }
}

/// A picture file. Writing to memory fails only for sizes that a file's header cannot hold; such a picture
/// stays empty, which every reader refuses by name.
fn compressed(format: &str, is_complete: bool, data: Vec<u8>) -> Picture {
    Picture::Compressed {
        format: format.to_owned(),
        data: if is_complete {
            data.into()
        } else {
            Bytes::new()
        },
    }
}

/// Linear values behind a mosaic of red, green, green and blue, with noise, in [0, 1].
fn mosaic(rendered: &Rendered, sensor: &ColorSensor, gains: Light3, key: [u64; 4]) -> Grid<f32> {
    sensed(rendered, sensor, key, |light, x, y| {
        let channel = x % 2 + y % 2;
        light[channel] * gains[channel]
    })
}

/// Linear values, with noise, in [0, 1] of a sensor that takes of the light on a pixel what `filter` lets through.
fn sensed(
    rendered: &Rendered,
    sensor: &ColorSensor,
    key: [u64; 4],
    filter: impl Fn(Light3, usize, usize) -> f32,
) -> Grid<f32> {
    let (width, height) = rendered.size();
    let mut values = Grid::filled(width, height, 0.0);
    let mut light = vec![[0.0; 3]; width];
    let mut normal = vec![0.0; width];
    let full_well = sensor.full_well as f32;
    let read_variance = (sensor.read_noise * sensor.read_noise) as f32;
    for y in 0..height {
        rendered.fill_row(y, &mut light);
        if full_well > 0.0 {
            Random::new(&[key[0], key[1], key[2], key[3], y as u64]).fill_normal(&mut normal);
        }
        let row = values.row_mut(y);
        for (x, value) in row.iter_mut().enumerate() {
            let linear = filter(light[x], x, y);
            *value = if full_well > 0.0 {
                let electrons = linear * full_well;
                let noise = (electrons + read_variance).sqrt() * normal[x];
                ((electrons + noise) / full_well).clamp(0.0, 1.0)
            } else {
                linear.clamp(0.0, 1.0)
            };
        }
    }
    values
}

/// Rows of red, green and blue, sRGB-encoded, as a camera develops its mosaic. A sensor without noise has
/// no mosaic either, so that a test can ask for exact colours.
fn developed(rendered: &Rendered, sensor: &ColorSensor, gains: Light3, key: [u64; 4]) -> Vec<u8> {
    let (width, height) = rendered.size();
    let mut rgb = Vec::with_capacity(width * height * 3);
    if sensor.full_well <= 0.0 {
        let mut light = vec![[0.0; 3]; width];
        for y in 0..height {
            rendered.fill_row(y, &mut light);
            rgb.extend(
                light
                    .iter()
                    .flat_map(|l| [0, 1, 2].map(|c| srgb(l[c] * gains[c]))),
            );
        }
        return rgb;
    }
    let mosaic = mosaic(rendered, sensor, gains, key);
    for y in 0..height {
        let rows = [mirrored(y, -1, height), y, mirrored(y, 1, height)].map(|y| mosaic.row(y));
        for x in 0..width {
            let columns = [mirrored(x, -1, width), x, mirrored(x, 1, width)];
            rgb.extend(demosaiced(rows, columns, x % 2, y % 2).map(srgb));
        }
    }
    rgb
}

/// The neighbour in a mosaic, mirrored at the border, where the colours stay in their places.
fn mirrored(at: usize, by: isize, size: usize) -> usize {
    let to = at as isize + by;
    let inside = (0..size as isize).contains(&to);
    let to = if inside { to } else { at as isize - by };
    to.clamp(0, size as isize - 1) as usize
}

/// Bilinear demosaicing of one pixel from its 3x3 neighbours.
#[inline]
fn demosaiced(rows: [&[f32]; 3], columns: [usize; 3], odd_x: usize, odd_y: usize) -> Light3 {
    let [above, here, below] = rows;
    let [left, x, right] = columns;
    let beside = (here[left] + here[right]) * 0.5;
    let over = (above[x] + below[x]) * 0.5;
    let diagonal = (above[left] + above[right] + below[left] + below[right]) * 0.25;
    let cross = (beside + over) * 0.5;
    match (odd_x, odd_y) {
        (0, 0) => [here[x], cross, diagonal],
        (1, 1) => [diagonal, cross, here[x]],
        (1, 0) => [beside, here[x], over],
        _ => [over, here[x], beside],
    }
}

const CURVE: usize = 1 << 14;

/// The sRGB curve (IEC 61966-2-1) as a table.
static SRGB: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let encoded = |k: usize| {
        let linear = k as f64 / (CURVE - 1) as f64;
        let value = match linear <= 0.003_130_8 {
            true => 12.92 * linear,
            false => 1.055 * linear.powf(1.0 / 2.4) - 0.055,
        };
        (value * 255.0).round() as u8
    };
    (0..CURVE).map(encoded).collect()
});

fn srgb(linear: f32) -> u8 {
    SRGB[((linear * (CURVE - 1) as f32 + 0.5) as usize).min(CURVE - 1)]
}
