//! Which side a pixel of the band is on: the one whose nearest colours it resembles. Several colours stand
//! for the object, so that a bright rim beside a dark wall hides neither.

use super::{Band, Colors, clip};
use crate::image::{Mask, srgb};

/// Colours that stand for the object beside a cell.
const SAMPLES: usize = 8;
/// How much a pixel's coarse decision weighs, in squared standard deviations.
const PRIOR: f32 = 4.0;
/// How far a colour may be from a sample's and still be the same surface, as a share.
const TEXTURE: f32 = 0.05;

/// What is beside a cell.
struct Beside {
    /// Linear light of object cells, nearest first.
    object: [[f32; 3]; SAMPLES],
    objects: usize,
    /// The backdrop's light over the expected: less in a shadow, more under spill.
    shade: [f32; 3],
}

/// Sets every pixel of the band to 0 or 255.
pub(super) fn classify(level: &mut Mask, colors: &Colors, band: &Band) {
    let offsets = offsets(super::BAND_PX / band.cells.size + 3);
    for &cell in &band.members {
        let beside = beside(colors, band, cell, &offsets);
        let prior = if band.object[cell] { PRIOR } else { -PRIOR };
        let r = band.cells.pixels(cell.0, cell.1);
        for y in r.y0..r.y1 {
            for x in r.x0..r.x1 {
                let object = preference(colors, &beside, x, y) + prior > 0.0;
                level[(x, y)] = if object { 255 } else { 0 };
            }
        }
    }
    calm(level, band);
}

/// Steps to the cells around one, nearest first.
fn offsets(radius: usize) -> Vec<(isize, isize)> {
    let r = radius as isize;
    let mut offsets: Vec<_> = (-r..=r)
        .flat_map(|dy| (-r..=r).map(move |dx| (dx, dy)))
        .collect();
    offsets.sort_by_key(|&(dx, dy)| (dx * dx + dy * dy, dy, dx));
    offsets
}

fn beside(
    colors: &Colors,
    band: &Band,
    (cx, cy): (usize, usize),
    offsets: &[(isize, isize)],
) -> Beside {
    let mut beside = Beside {
        object: [[0.0; 3]; SAMPLES],
        objects: 0,
        shade: [1.0; 3],
    };
    let (mut seen, mut expected, mut backdrops) = ([1e-3f32; 3], [1e-3f32; 3], 0);
    for &(dx, dy) in offsets {
        let (x, y) = (cx.wrapping_add_signed(dx), cy.wrapping_add_signed(dy));
        if x >= band.object.width() || y >= band.object.height() || !is_pure(band, x, y) {
            continue;
        }
        let light = band.cells.picture[(x, y)].map(srgb::decode);
        if band.object[(x, y)] && beside.objects < SAMPLES {
            beside.object[beside.objects] = light;
            beside.objects += 1;
        } else if !band.object[(x, y)] && backdrops < SAMPLES {
            let plate = band.cells.plate[(x, y)];
            for c in 0..3 {
                seen[c] += light[c];
                expected[c] += colors.expected[c][(plate[c] + 0.5) as usize];
            }
            backdrops += 1;
        }
        if beside.objects == SAMPLES && backdrops == SAMPLES {
            break;
        }
    }
    beside.shade = std::array::from_fn(|c| seen[c] / expected[c]);
    beside
}

/// Whether a cell and those beside it are all of one side.
fn is_pure(band: &Band, x: usize, y: usize) -> bool {
    let object = band.object;
    let value = object[(x, y)];
    let (ix, iy) = (x as isize, y as isize);
    let columns = clip(ix - 1, ix + 1, 0..object.width());
    clip(iy - 1, iy + 1, 0..object.height())
        .all(|y| object.row(y)[columns.clone()].iter().all(|&v| v == value))
}

/// How much nearer a pixel's colour is to the object's than to the backdrop's, in squared standard
/// deviations.
#[inline]
fn preference(colors: &Colors, beside: &Beside, x: usize, y: usize) -> f32 {
    let (light, expected) = (colors.light(x, y), colors.expected(x, y));
    let weight = colors.weight(x, y);
    let mut to_backdrop = 0.0;
    for c in 0..3 {
        to_backdrop += weight[c] * (light[c] - expected[c] * beside.shade[c]).powi(2);
    }
    // Where no cell shows the object alone (it is thin), whatever differs clearly is object.
    let mut to_object = if beside.objects == 0 { 16.0 } else { f32::MAX };
    for sample in &beside.object[..beside.objects] {
        let mut distance = 0.0;
        for c in 0..3 {
            let variance = 1.0 + weight[c] * (TEXTURE * sample[c]).powi(2);
            distance += weight[c] * (light[c] - sample[c]).powi(2) / variance;
        }
        to_object = to_object.min(distance);
    }
    to_backdrop - to_object
}

/// Lets single pixels follow the majority of the nine around them.
fn calm(level: &mut Mask, band: &Band) {
    let (width, height) = (level.width(), level.height());
    let mut turned = Vec::new();
    band.for_pixels(|x, y| {
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        let count = columns.len() * rows.len();
        let objects: usize = rows
            .map(|y| {
                let row = &level.row(y)[columns.clone()];
                row.iter().map(|&l| usize::from(l >> 7)).sum::<usize>()
            })
            .sum();
        let is_object = level[(x, y)] >= 128;
        let alone = if is_object {
            objects <= 3
        } else {
            objects + 3 >= count
        };
        if alone {
            turned.push((x, y));
        }
    });
    for pixel in turned {
        level[pixel] = 255 - level[pixel];
    }
}
