//! Where the object ends in a depth camera's view, against the outline of the hull. Both are of the same object: they
//! lie apart only as far as the calibrations of the depth camera and of the colour cameras do, or as the hull stands
//! out. A wrong focal length moves no reading of the table, but every outline. Nothing here carves.

use super::bias::{Bias, depth_of_table, mean_depth};
use super::front::HullRenderings;
use crate::reconstruct::DepthView;
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;

/// How far apart the two outlines are.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct OutlineOffset {
    /// Places of the hull's outline at which the end of the object was read.
    pub places: usize,
    /// Metres by which the object surely ends outside of the hull's outline, negative inside: the mean of the middle
    /// half of the places.
    pub outwards: f64,
    /// Metres by which it surely ends elsewhere, on either side: the same mean.
    pub apart: f64,
}

/// Pixels to either side of the hull's outline in which the object's end is looked for.
const REACH_PX: isize = 10;
/// Pixels of the hull's outline by which its direction is found.
const AROUND_PX: isize = 3;
/// Metres of depth that the table has to lie behind the hull's far side for their readings to be told apart.
const LEAST_GAP: f32 = 0.01;
/// Fewest readings of what is behind the object by which a place counts.
const FEWEST_READINGS: usize = 3;
/// Fewest places that make a mean.
const FEWEST_PLACES: usize = 15;

/// Compares the two outlines; `None` where what is behind the object was read in too few places.
pub fn outline_offset(
    view: &DepthView,
    front: &HullRenderings,
    bias: &Bias,
) -> Option<OutlineOffset> {
    let outline = Outline { view, front, bias };
    let (width, height) = (front.depth.width() as isize, front.depth.height() as isize);
    let rows = REACH_PX..height - REACH_PX;
    let of_row = |y: isize| -> Vec<(f32, f32)> {
        let columns = REACH_PX..width - REACH_PX;
        columns.filter_map(|x| outline.offset_at(x, y)).collect()
    };
    let each: Vec<Vec<(f32, f32)>> = rows.into_par_iter().map(of_row).collect();
    let offsets = each.concat();
    if offsets.len() < FEWEST_PLACES {
        return None;
    }
    let metres = |&(pixels, pixel): &(f32, f32)| pixels * pixel;
    let mut outwards: Vec<f32> = offsets.iter().map(metres).collect();
    let mut apart: Vec<f32> = outwards.iter().map(|o| o.abs()).collect();
    Some(OutlineOffset {
        places: offsets.len(),
        outwards: mean_of_middle_half(&mut outwards),
        apart: mean_of_middle_half(&mut apart),
    })
}

fn mean_of_middle_half(values: &mut [f32]) -> f64 {
    values.sort_by(f32::total_cmp);
    let quarter = values.len() / 4;
    let middle = &values[quarter..values.len() - quarter];
    middle.iter().map(|&v| f64::from(v)).sum::<f64>() / middle.len().max(1) as f64
}

struct Outline<'a> {
    view: &'a DepthView,
    front: &'a HullRenderings,
    bias: &'a Bias,
}

impl Outline<'_> {
    fn is_hull(&self, x: isize, y: isize) -> bool {
        self.front.depth.get(x, y).is_some_and(|d| d.is_finite())
    }

    /// At a pixel on the hull's outline, how many pixels outside of that the object ends, and the length of a pixel
    /// there in metres. `None` elsewhere, where the outline is no border between the object and a table far behind it,
    /// and where too little was read.
    fn offset_at(&self, x: isize, y: isize) -> Option<(f32, f32)> {
        let beside = [(-1, 0), (1, 0), (0, -1), (0, 1)];
        let is_border =
            self.is_hull(x, y) && beside.iter().any(|(dx, dy)| !self.is_hull(x + dx, y + dy));
        if !is_border {
            return None;
        }
        let outwards = self.outwards(x, y)?;
        let at = |steps: isize| {
            let to = outwards * steps as f32;
            (x + to.x.round() as isize, y + to.y.round() as isize)
        };
        let is_straight = (2..=REACH_PX).all(|k| {
            let ((inner_x, inner_y), (outer_x, outer_y)) = (at(1 - k), at(k));
            self.is_hull(inner_x, inner_y) && !self.is_hull(outer_x, outer_y)
        });
        if !is_straight {
            return None;
        }
        let pixel = Point2::new(x as f64, y as f64);
        let table = depth_of_table(&self.view.camera, pixel, self.bias.table)? as f32;
        let (inner_x, inner_y) = at(-1);
        let exit = *self
            .front
            .exit
            .get(inner_x, inner_y)
            .filter(|d| d.is_finite())?;
        if table - exit < LEAST_GAP {
            return None;
        }
        let middle = 0.5 * (exit + table);
        let read = |k: isize| {
            let (x, y) = at(k);
            let depth = mean_depth(self.view, x as usize, y as usize)?;
            Some(((depth - self.bias.metres) as f32) < middle)
        };
        let is_object: Vec<Option<bool>> = (1 - REACH_PX..=REACH_PX).map(read).collect();
        let (first, last) = ends_of_object(&is_object)?;
        let offset = REACH_PX.clamp(first as isize, last as isize) - REACH_PX;
        let focal = self.view.camera.camera.intrinsics.focal_px.min() as f32;
        Some((offset as f32, exit / focal))
    }

    /// The direction away from the hull, by the pixels of it around.
    fn outwards(&self, x: isize, y: isize) -> Option<Vector2<f32>> {
        let mut sum = Vector2::<f32>::zeros();
        for dy in -AROUND_PX..=AROUND_PX {
            for dx in -AROUND_PX..=AROUND_PX {
                if self.is_hull(x + dx, y + dy) {
                    sum -= Vector2::new(dx as f32, dy as f32);
                }
            }
        }
        sum.try_normalize(1.0)
    }
}

/// After how many pixels at least and at most the object ends, given from its inside outwards for each whether it was
/// read as the object: where it is first met from outside, by two readings one after the other, since a single one may
/// be of a mixed pixel. Farther in, the floor of a vessel may be as deep as the table. Beside a border often nothing is
/// read.
fn ends_of_object(is_object: &[Option<bool>]) -> Option<(usize, usize)> {
    let read: Vec<(usize, bool)> = (0..)
        .zip(is_object)
        .filter_map(|(i, o)| Some((i, (*o)?)))
        .collect();
    let met = read.windows(2).rposition(|two| two[0].1 && two[1].1)? + 1;
    let outside: Vec<usize> = read[met..].iter().filter(|r| !r.1).map(|r| r.0).collect();
    (outside.len() >= FEWEST_READINGS).then(|| (read[met].0 + 1, outside[0]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_object_ends_where_readings_change_sides_or_amid_those_that_are_missing() {
        let read = |text: &str| -> Vec<Option<bool>> {
            let each = text.chars().map(|c| match c {
                'o' => Some(true),
                't' => Some(false),
                _ => None,
            });
            each.collect()
        };
        assert_eq!(ends_of_object(&read("oooottttt")), Some((4, 4)));
        assert_eq!(ends_of_object(&read("oooo..ttt")), Some((4, 6)));
        // A single reading of a mixed pixel is none of the object.
        assert_eq!(ends_of_object(&read("ooootttot")), Some((4, 4)));
        // The floor of a vessel, far below its rim.
        assert_eq!(ends_of_object(&read("ttttt.oo.ttt")), Some((8, 9)));
        assert_eq!(ends_of_object(&read("ooooooott")), None);
        assert_eq!(ends_of_object(&read("tttttotttt")), None);
    }
}
