//! Makes a silhouette of a mask that the recording has, without moving its contour.

use super::facts::{self, Facts};
use super::region::Region;
use super::{Parameters, Silhouette, components};
use crate::image::{Mask, PixelRect, RgbImage};
use std::borrow::Cow;

/// The mask as a level set; an error says why there is no object. A stray pixel stays in the level set, but counts for
/// nothing in the bounds, by which a displacement of the silhouette is judged.
pub(super) fn silhouette(
    picture: &RgbImage,
    mask: &Mask,
    region: &Region,
    parameters: &Parameters,
) -> Result<Silhouette, String> {
    let whole = PixelRect::whole(mask.width(), mask.height());
    let bounds = facts::bounds(mask, whole);
    if bounds.is_empty() {
        return Err("no pixel of its mask is 128 or more".to_owned());
    }
    let bright = bright(mask);
    let level = if is_soft(&bright) {
        saturated(&bright)
    } else {
        smoothed(&bright, bounds)
    };
    let bounds = components::object_bounds(mask, bounds, region, parameters);
    Ok(Silhouette {
        facts: Facts::of_level(picture, &level, bounds),
        bounds,
        region: whole,
        level,
        unknown: None,
    })
}

/// How far the levels inside a dim object may spread around their median.
const SPREAD: usize = 10;

/// The mask with an object of 255: carving is checked only where a level is surely inside. The contour stays where it
/// is, for levels below 128 stay, and 128 does.
fn bright(mask: &Mask) -> Cow<'_, Mask> {
    let Some(top) = dim_inside(mask) else {
        return Cow::Borrowed(mask);
    };
    Cow::Owned(mask.map(|&level| match level {
        0..128 => level,
        _ if level >= top => 255,
        _ => {
            let (above, span) = (u32::from(level - 128), u32::from(top - 128));
            128 + (above * 127 / span) as u8
        }
    }))
}

/// The level inside the object, if that is well below 255; `None` also where most of the object is contour.
fn dim_inside(mask: &Mask) -> Option<u8> {
    let mut counts = [0usize; 256];
    for &level in mask.pixels() {
        counts[usize::from(level)] += 1;
    }
    let object: usize = counts[128..].iter().sum();
    let mut up_to = 0;
    let median = (128..=255u8).find(|&level| {
        up_to += counts[usize::from(level)];
        2 * up_to > object
    })?;
    let middle = usize::from(median);
    let alike = &counts[(middle - SPREAD).max(128)..=(middle + SPREAD).min(255)];
    let is_inside = 2 * alike.iter().sum::<usize>() > object;
    (is_inside && median < 255 - NEARLY).then_some(median)
}

/// Whether the mask has grey levels along its contour, which then say where in a pixel it passes.
fn is_soft(mask: &Mask) -> bool {
    let (mut grey, mut steps) = (0usize, 0usize);
    for y in 0..mask.height() {
        for pair in mask.row(y).windows(2) {
            grey += usize::from((16..240).contains(&pair[0]));
            steps += usize::from((pair[0] >= 128) != (pair[1] >= 128));
        }
    }
    grey * 4 > steps
}

/// Pixels around one within which a contour may need its level.
const BESIDE_CONTOUR: isize = 2;
/// Levels up to this far from 0 or 255 count as that where all around are such.
const NEARLY: u8 = 5;

/// A soft mask with even sides: programs that cut out pictures leave an object at 252 to 255, and where a level changes
/// an outline is taken to be near.
fn saturated(mask: &Mask) -> Mask {
    Mask::from_fn_parallel(mask.width(), mask.height(), |x, y| {
        let level = mask[(x, y)];
        let is_object = level >= 255 - NEARLY;
        if level == 0 || level == 255 || !(is_object || level <= NEARLY) {
            return level;
        }
        let reach = -BESIDE_CONTOUR..=BESIDE_CONTOUR;
        let around = reach
            .clone()
            .flat_map(|dy| reach.clone().map(move |dx| (dx, dy)));
        let mut around = around.filter_map(|(dx, dy)| mask.get(x as isize + dx, y as isize + dy));
        let is_even = around.all(|&other| match is_object {
            true => other >= 255 - NEARLY,
            false => other <= NEARLY,
        });
        match (is_even, is_object) {
            (true, true) => 255,
            (true, false) => 0,
            (false, _) => level,
        }
    })
}

/// A light blur (binomial, 3x3) that widens the step and smooths its stairs. Every pixel stays on its side,
/// so that corners and lines one pixel wide are as they were.
fn smoothed(mask: &Mask, bounds: PixelRect) -> Mask {
    let mut level = mask.map(|&v| if v >= 128 { 255 } else { 0 });
    let original = level.clone();
    let around = bounds.grown(1, mask.width(), mask.height());
    for y in around.y0..around.y1 {
        for x in around.x0..around.x1 {
            let blurred = binomial(&original, x, y);
            level[(x, y)] = if original[(x, y)] == 255 {
                blurred.max(144)
            } else {
                blurred.min(111)
            };
        }
    }
    level
}

/// Pixels beyond the border repeat those on it: the object is not closed there.
fn binomial(grid: &Mask, x: usize, y: usize) -> u8 {
    let mut sum = 0u32;
    for (dy, wy) in [(-1isize, 1u32), (0, 2), (1, 1)] {
        let ny = y.saturating_add_signed(dy).min(grid.height() - 1);
        for (dx, wx) in [(-1isize, 1u32), (0, 2), (1, 1)] {
            let nx = x.saturating_add_signed(dx).min(grid.width() - 1);
            sum += wy * wx * u32::from(grid[(nx, ny)]);
        }
    }
    ((sum + 8) / 16) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_soft_mask_is_even_but_for_its_contour() {
        // A ramp of two pixels around a disc whose inside is not quite 255, in a backdrop that is not quite 0.
        let mask = Mask::from_fn(60, 60, |x, y| {
            let inside = 20.0 - (x as f64 - 29.5).hypot(y as f64 - 29.5);
            let level = (128.0 + 64.0 * inside).clamp(0.0, 255.0) as u8;
            let uneven = ((7 * x + 3 * y) % 4) as u8;
            level.clamp(uneven, 255 - uneven)
        });
        let level = silhouette_of(&mask).level;
        let (mut kept, mut even) = (0, 0);
        for y in 0..60 {
            for x in 0..60 {
                let from_contour = 20.0 - (x as f64 - 29.5).hypot(y as f64 - 29.5);
                if from_contour.abs() < 1.0 {
                    assert_eq!(level[(x, y)], mask[(x, y)]);
                    kept += 1;
                } else if from_contour.abs() > 5.0 {
                    assert!([0, 255].contains(&level[(x, y)]), "{x}, {y}");
                    even += 1;
                }
            }
        }
        assert!(kept > 200 && even > 2000, "{kept}, {even}");
    }

    fn silhouette_of(mask: &Mask) -> Silhouette {
        let picture = RgbImage::filled(mask.width(), mask.height(), [100; 3]);
        let region = anywhere(mask);
        silhouette(&picture, mask, &region, &Parameters::default()).unwrap()
    }

    /// The projection of a volume that surrounds the camera.
    fn anywhere(mask: &Mask) -> Region {
        Region {
            rect: PixelRect::whole(mask.width(), mask.height()),
            outline: Vec::new(),
            picture: (mask.width(), mask.height()),
        }
    }

    /// A disc around the middle of a picture of 60 by 60.
    fn disc(radius: f64) -> Mask {
        Mask::from_fn(60, 60, |x, y| {
            let inside = radius - (x as f64 - 29.5).hypot(y as f64 - 29.5);
            if inside >= 0.0 { 255 } else { 0 }
        })
    }

    #[test]
    fn a_dim_mask_is_as_good_as_a_bright_one() {
        let soft = Mask::from_fn(60, 60, |x, y| {
            let inside = 20.0 - (x as f64 - 29.5).hypot(y as f64 - 29.5);
            (127.5 + 100.0 * inside).clamp(0.0, 255.0) as u8
        });
        for (mask, dim) in [(soft, 240), (disc(20.0), 240), (disc(20.0), 128)] {
            let capped = mask.map(|&level| level.min(dim));
            let (capped, full) = (silhouette_of(&capped).level, silhouette_of(&mask).level);
            for (&capped, &full) in capped.pixels().iter().zip(full.pixels()) {
                assert_eq!(capped >= 128, full >= 128);
                assert!(capped.abs_diff(full) <= 15, "{capped}, {full}");
                assert!(capped == 255 || full < 255, "{capped}");
            }
        }
    }

    #[test]
    fn a_mask_that_is_mostly_contour_is_not_brightened() {
        let wire = Mask::from_fn(60, 60, |x, y| {
            let from_middle = (x as f64 - 0.37 * y as f64 - 15.0).abs();
            (230.0 - 120.0 * from_middle).clamp(0.0, 255.0) as u8
        });
        assert_eq!(dim_inside(&wire), None);
    }

    #[test]
    fn stray_pixels_stay_but_are_not_in_the_bounds() {
        let clean = disc(15.0);
        let mut mask = clean.clone();
        (mask[(3, 3)], mask[(56, 56)]) = (255, 255);
        let found = silhouette_of(&mask);
        assert_eq!(found.bounds, silhouette_of(&clean).bounds);
        assert!(found.level[(3, 3)] >= 128 && found.level[(56, 56)] >= 128);
    }

    #[test]
    fn what_no_part_of_the_volume_projects_to_is_not_in_the_bounds() {
        let clean = disc(15.0);
        let beside = |x: usize, y: usize| x >= 55 && y >= 10;
        let mask = Mask::from_fn(
            60,
            60,
            |x, y| if beside(x, y) { 255 } else { clean[(x, y)] },
        );
        let picture = RgbImage::filled(60, 60, [100; 3]);
        let corners = [(10.0, 10.0), (50.0, 10.0), (50.0, 50.0), (10.0, 50.0)];
        let region = Region {
            outline: corners.map(|(x, y)| Point2::new(x, y)).to_vec(),
            ..anywhere(&mask)
        };
        let found = silhouette(&picture, &mask, &region, &Parameters::default()).unwrap();
        assert_eq!(found.bounds, silhouette_of(&clean).bounds);
    }

    #[test]
    fn a_binary_mask_keeps_its_pixels_and_its_contour() {
        let mut mask = Grid::from_fn(40, 30, |x, y| if x >= 10 && y > 4 { 255 } else { 0 });
        mask[(3, 20)] = 255;
        let found = silhouette_of(&mask);
        for (level, mask) in found.level.pixels().iter().zip(mask.pixels()) {
            assert_eq!(*level >= 128, *mask >= 128);
        }
        let left = found.level_at(9.5, 15.0).unwrap();
        assert!((left - 127.5).abs() < 1.0, "{left}");
        // The object leaves the picture on the right and below: it stays open there.
        assert_eq!(found.level_at(39.4, 15.0), Some(255.0));
        assert_eq!(found.level_at(20.0, 29.4), Some(255.0));
        assert_eq!(found.level_at(39.6, 15.0), None);
    }

    #[test]
    fn a_soft_mask_is_kept_to_the_bit() {
        let mask = Grid::from_fn(30, 30, |x, _| [0, 40, 200, 255][(x / 3).min(3)]);
        assert_eq!(silhouette_of(&mask).level, mask);
    }

    #[test]
    fn an_empty_mask_is_refused() {
        let picture = RgbImage::filled(8, 8, [0; 3]);
        let mask = Mask::filled(8, 8, 127);
        assert!(silhouette(&picture, &mask, &anywhere(&mask), &Parameters::default()).is_err());
    }

    use crate::image::Grid;
    use nalgebra::Point2;
}
