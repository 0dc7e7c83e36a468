//! Decides on which side a pixel of the band is: that whose nearest colours it resembles. Several colours stand for
//! the object, so that a bright rim beside a dark wall hides neither.

use super::{Band, Colors};
use crate::array::three;
use crate::image::{Grid, Mask, PixelRect, srgb};

/// Colours that stand for the object beside a cell.
const SAMPLES: usize = 8;
/// How much a pixel's coarse decision weighs, in squared standard deviations.
const PRIOR: f32 = 4.0;
/// How far a colour may be from a sample's and still be the same surface, as a share.
const TEXTURE: f32 = 0.05;
/// How much darker or brighter than a sample the object is beside it, as a share, one standard deviation: a surface
/// that turns away towards its outline, or down into its own shadow, keeps its hue but not its brightness.
const SHADING: f32 = 0.2;
/// How much darker than beside it the backdrop is, as a share, one standard deviation: where the object touches it, its
/// shadow deepens within a few pixels.
const DEEPENING: f32 = 0.05;

/// What is beside a cell.
struct CellNeighbors {
    /// The object's colours in linear light, per channel; only the first `objects` count.
    object: [[f32; SAMPLES]; 3],
    /// Reciprocal variances of the distance to each.
    weight: [[f32; SAMPLES]; 3],
    /// Sum of the weighted squares of each one's channels.
    square: [f32; SAMPLES],
    objects: usize,
    /// The backdrop's light over the expected: less in a shadow, more under spill.
    shade: [f32; 3],
    /// Reciprocal variances of the distance to the backdrop.
    backdrop_weight: [f32; 3],
}

/// Sets every pixel of the band to 0 or 255.
pub(super) fn classify(level: &mut Mask, colors: &Colors, band: &Band) {
    let offsets = offsets(super::BAND_PX / band.cells.size + 3);
    let pure = pure_cells(band.object);
    for &cell in &band.members {
        let beside = beside(colors, band, &pure, cell, &offsets);
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
    drop_specks(level, band);
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

/// Whether a cell and those beside it are all of one side.
fn pure_cells(object: &Grid<bool>) -> Grid<bool> {
    let (columns, rows) = (object.width(), object.height());
    let mut pure = Grid::filled(columns, rows, true);
    let mut mixed = vec![false; columns];
    for y in 0..rows {
        let (row, above, below) = (
            object.row(y),
            object.row(y.saturating_sub(1)),
            object.row((y + 1).min(rows - 1)),
        );
        for (x, mixed) in mixed.iter_mut().enumerate() {
            *mixed = row[x] != above[x] || row[x] != below[x];
        }
        let out = pure.row_mut(y);
        for x in 0..columns {
            let (left, right) = (x.saturating_sub(1), (x + 1).min(columns - 1));
            let alike = row[left] == row[x] && row[right] == row[x];
            out[x] = alike && !mixed[left] && !mixed[x] && !mixed[right];
        }
    }
    pure
}

/// Reciprocal variance of the distance to a colour of a surface that is not quite of one colour. It is the same
/// for both sides, so that a pixel that mixes them equally is as near to the one as to the other.
#[inline]
fn textured(weight: f32, light: f32) -> f32 {
    weight / (1.0 + weight * (TEXTURE * light).powi(2))
}

fn beside(
    colors: &Colors,
    band: &Band,
    pure: &Grid<bool>,
    (cx, cy): (usize, usize),
    offsets: &[(isize, isize)],
) -> CellNeighbors {
    let plate = three(|c| (band.cells.plate[(cx, cy)][c] + 0.5) as usize);
    let weight = three(|c| colors.weight[c][plate[c]]);
    let mut beside = CellNeighbors {
        object: [[0.0; SAMPLES]; 3],
        weight: [[0.0; SAMPLES]; 3],
        square: [0.0; SAMPLES],
        objects: 0,
        shade: [1.0; 3],
        backdrop_weight: three(|c| textured(weight[c], colors.expected[c][plate[c]])),
    };
    let (mut seen, mut expected, mut backdrops) = ([1e-3f32; 3], [1e-3f32; 3], 0);
    for &(dx, dy) in offsets {
        let (x, y) = (cx.wrapping_add_signed(dx), cy.wrapping_add_signed(dy));
        if x >= pure.width() || y >= pure.height() || !pure[(x, y)] {
            continue;
        }
        if band.object[(x, y)] && beside.objects < SAMPLES {
            let light = srgb::decode_pixel(band.cells.picture[(x, y)]);
            for c in 0..3 {
                let weight = textured(weight[c], light[c]);
                beside.object[c][beside.objects] = light[c];
                beside.weight[c][beside.objects] = weight;
                beside.square[beside.objects] += weight * light[c] * light[c];
            }
            beside.objects += 1;
        } else if !band.object[(x, y)] && backdrops < SAMPLES {
            let light = srgb::decode_pixel(band.cells.picture[(x, y)]);
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
    beside.shade = three(|c| seen[c] / expected[c]);
    beside
}

/// How much nearer a pixel's colour is to the object's than to the backdrop's, in squared standard
/// deviations.
#[inline]
fn preference(colors: &Colors, beside: &CellNeighbors, x: usize, y: usize) -> f32 {
    let (light, expected) = (colors.light(x, y), colors.expected(x, y));
    let backdrop = three(|c| expected[c] * beside.shade[c]);
    let to_backdrop = to_backdrop(light, backdrop, beside.backdrop_weight);
    let (mut square, mut product) = ([0.0f32; SAMPLES], [0.0f32; SAMPLES]);
    for (c, light) in light.into_iter().enumerate() {
        for i in 0..SAMPLES {
            let weighted = beside.weight[c][i] * light;
            square[i] += weighted * light;
            product[i] += weighted * beside.object[c][i];
        }
    }
    // The least of |light - s sample|² + ((s - 1) / SHADING)² over all s.
    let known = 1.0 / (SHADING * SHADING);
    let distance =
        |i: usize| square[i] + known - (product[i] + known).powi(2) / (beside.square[i] + known);
    // Where no cell shows the object alone (it is thin), whatever differs clearly is object.
    let to_object = (0..beside.objects).map(distance).reduce(f32::min);
    to_backdrop - to_object.unwrap_or(16.0)
}

/// Squared distance of a pixel's light from the backdrop's, in standard deviations: the least of
/// |light - s backdrop|² + ((s - 1) / DEEPENING)² over all s of at most 1.
#[inline]
fn to_backdrop(light: [f32; 3], backdrop: [f32; 3], weight: [f32; 3]) -> f32 {
    let known = 1.0 / (DEEPENING * DEEPENING);
    let (mut product, mut square) = (known, known);
    for c in 0..3 {
        let weighted = weight[c] * backdrop[c];
        product += weighted * light[c];
        square += weighted * backdrop[c];
    }
    let share = (product / square).min(1.0);
    let off = |c: usize| weight[c] * (light[c] - share * backdrop[c]).powi(2);
    off(0) + off(1) + off(2) + known * (share - 1.0).powi(2)
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

/// Most pixels of a speck.
const SPECK_PX: usize = 24;

/// Gives pieces of a few pixels to the side that surrounds them: noise beside the contour.
fn drop_specks(level: &mut Mask, band: &Band) {
    let region = band.cells.region;
    let mut known = Grid::filled(region.width(), region.height(), false);
    let mut piece = Vec::with_capacity(SPECK_PX + 4);
    let mut specks = Vec::new();
    band.for_pixels(|x, y| {
        if !known[(x - region.x0, y - region.y0)] {
            piece.clear();
            if is_speck(level, region, (x, y), &mut known, &mut piece) {
                specks.extend_from_slice(&piece);
            }
        }
    });
    for pixel in specks {
        level[pixel] = 255 - level[pixel];
    }
}

/// Collects the piece of one side that a pixel belongs to, until it is too large to be a speck, reaches the
/// region's border or meets a piece that was looked at before (which was larger, or this one would have been
/// in it).
fn is_speck(
    level: &Mask,
    region: PixelRect,
    start: (usize, usize),
    known: &mut Grid<bool>,
    piece: &mut Vec<(usize, usize)>,
) -> bool {
    let object = level[start] >= 128;
    let mut is_small = true;
    piece.push(start);
    known[(start.0 - region.x0, start.1 - region.y0)] = true;
    let first_of_piece = piece.len() - 1;
    let mut next = first_of_piece;
    while is_small && next < piece.len() {
        let (x, y) = piece[next];
        next += 1;
        for (dx, dy) in [(1isize, 0isize), (-1, 0), (0, 1), (0, -1)] {
            let (nx, ny) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            if !region.contains(nx, ny) {
                is_small = false;
            } else if (level[(nx, ny)] >= 128) == object && !piece.contains(&(nx, ny)) {
                let seen = &mut known[(nx - region.x0, ny - region.y0)];
                is_small &= !*seen && piece.len() < SPECK_PX;
                *seen = true;
                piece.push((nx, ny));
            }
        }
    }
    is_small
}

#[cfg(test)]
mod tests {
    use super::*;

    const WEIGHT: [f32; 3] = [100.0, 200.0, 150.0];
    const BACKDROP: [f32; 3] = [0.2, 0.4, 0.6];

    #[test]
    fn a_backdrop_may_be_darker_than_beside_a_pixel_by_the_least_that_explains_it() {
        let light = [0.18, 0.37, 0.55];
        let at = |share: f32| {
            let off = |c: usize| WEIGHT[c] * (light[c] - share * BACKDROP[c]).powi(2);
            off(0) + off(1) + off(2) + ((share - 1.0) / DEEPENING).powi(2)
        };
        let least = (0..=1000)
            .map(|n| at(n as f32 / 1000.0))
            .fold(f32::MAX, f32::min);
        let found = to_backdrop(light, BACKDROP, WEIGHT);
        assert!((found - least).abs() < 1e-3 * least, "{found}, {least}");
        assert!(found < at(1.0), "{found}");
    }

    #[test]
    fn a_backdrop_is_not_brighter_than_beside_a_pixel() {
        let light = BACKDROP.map(|b| 1.1 * b);
        let as_bright: f32 = (0..3)
            .map(|c| WEIGHT[c] * (light[c] - BACKDROP[c]).powi(2))
            .sum();
        let found = to_backdrop(light, BACKDROP, WEIGHT);
        assert!(
            (found - as_bright).abs() < 1e-3 * as_bright,
            "{found}, {as_bright}"
        );
    }
}
