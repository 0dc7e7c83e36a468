//! The contours of a mask as closed polygons along the sides of its pixels.

use crate::image::Mask;
use std::collections::BTreeMap;

/// Corners that are kept, of the largest contours.
const MOST_CORNERS: usize = 4000;

/// The contours of what is 128 and up, the longest first, with the object to the right of their way. Short ones are
/// left out when all together have more than 4000 corners. A point (x, y) is the upper left corner of pixel (x, y).
pub(super) fn contours(mask: &Mask) -> Vec<Vec<[u16; 2]>> {
    let mut sides = sides(mask);
    let mut all = Vec::new();
    while let Some((&start, _)) = sides.first_key_value() {
        all.push(follow(&mut sides, start));
    }
    all.sort_by_key(|contour: &Vec<[u16; 2]>| std::cmp::Reverse(contour.len()));
    let mut corners = 0;
    all.retain(|contour| {
        corners += contour.len();
        corners <= MOST_CORNERS
    });
    all
}

/// From each corner, as [y, x], the corners to which a side goes that has the object on its right.
type Sides = BTreeMap<[u16; 2], Vec<[u16; 2]>>;

fn sides(mask: &Mask) -> Sides {
    let is_in = |x: isize, y: isize| mask.get(x, y).is_some_and(|&level| level >= 128);
    let mut sides = Sides::new();
    for y in 0..mask.height() as isize {
        for x in 0..mask.width() as isize {
            if !is_in(x, y) {
                continue;
            }
            for (beside, from, to) in [
                ((x, y - 1), (x, y), (x + 1, y)),
                ((x + 1, y), (x + 1, y), (x + 1, y + 1)),
                ((x, y + 1), (x + 1, y + 1), (x, y + 1)),
                ((x - 1, y), (x, y + 1), (x, y)),
            ] {
                if !is_in(beside.0, beside.1) {
                    let corner = |(x, y): (isize, isize)| [y as u16, x as u16];
                    sides.entry(corner(from)).or_default().push(corner(to));
                }
            }
        }
    }
    sides
}

/// Takes the sides of one contour; its corners as [x, y], without those at which it goes straight on.
fn follow(sides: &mut Sides, start: [u16; 2]) -> Vec<[u16; 2]> {
    let mut corners: Vec<[u16; 2]> = Vec::new();
    let mut at = start;
    while let Some(ways) = sides.get_mut(&at) {
        let next = ways.pop();
        if ways.is_empty() {
            sides.remove(&at);
        }
        let Some(next) = next else { break };
        corners.push(at);
        at = next;
    }
    let count = corners.len();
    let is_corner = |i: usize| {
        let [before, here, after] = [i + count - 1, i, i + 1].map(|i| corners[i % count]);
        !(before[0] == here[0] && here[0] == after[0]
            || before[1] == here[1] && here[1] == after[1])
    };
    let kept = (0..count).filter(|&i| is_corner(i));
    kept.map(|i| [corners[i][1], corners[i][0]]).collect()
}
