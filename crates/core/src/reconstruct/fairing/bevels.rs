//! Narrow strips between flat sides. The points of one edge are a fraction of a pixel off each other, so that the
//! convex hull has strips along it that are no sides, and nothing would hold the surface there. Which parts are sides
//! is not decided here.

use super::flat::{Flat, NARROW};
use std::collections::BTreeSet;

/// Facets that hang together and belong to no side.
struct Strip {
    facets: Vec<usize>,
    /// The sides around them.
    sides: BTreeSet<u32>,
}

impl Flat<'_> {
    /// Gives each facet of a narrow strip between sides to that side beside the strip that it faces most, so that sides
    /// meet at one edge. `is_side` says of each part whether it is a side.
    pub(super) fn give_bevels_to_sides(&mut self, is_side: &[bool]) {
        for strip in self.strips(is_side) {
            let area: f64 = strip
                .facets
                .iter()
                .map(|&t| 0.5 * self.cross(t).norm())
                .sum();
            let is_narrow = |side: &u32| area < NARROW * self.areas[*side as usize];
            if strip.sides.len() < 2 || !strip.sides.iter().all(is_narrow) {
                continue;
            }
            for t in strip.facets {
                let normal = match self.of_facet[t] {
                    Some(part) => self.planes[part as usize].normal,
                    None => self.cross(t),
                };
                let facing = |side: &u32| self.planes[*side as usize].normal.dot(&normal);
                let sides = strip.sides.iter().copied();
                self.of_facet[t] = sides.max_by(|a, b| facing(a).total_cmp(&facing(b)));
            }
        }
    }

    /// The strips of facets that belong to no side and do not lie on the table.
    fn strips(&self, is_side: &[bool]) -> Vec<Strip> {
        let side_of = |t: usize| self.of_facet[t].filter(|&part| is_side[part as usize]);
        let mut is_left: Vec<bool> = (0..self.of_facet.len())
            .map(|t| !self.is_foot[t] && side_of(t).is_none())
            .collect();
        let mut strips = Vec::new();
        for first in 0..is_left.len() {
            if !std::mem::take(&mut is_left[first]) {
                continue;
            }
            let mut strip = Strip {
                facets: vec![first],
                sides: BTreeSet::new(),
            };
            let mut next = 0;
            while let Some(&t) = strip.facets.get(next) {
                next += 1;
                for other in self.beside_facet(t).map(|other| other as usize) {
                    strip.sides.extend(side_of(other));
                    if std::mem::take(&mut is_left[other]) {
                        strip.facets.push(other);
                    }
                }
            }
            strips.push(strip);
        }
        strips
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::convex_hull;
    use nalgebra::Point3;

    const PIXEL: f64 = 1e-3;

    /// A block of 100 pixels with a bevel so many pixels wide along one edge; the sides that its facets belong to after
    /// bevels were given to sides, and how many there are.
    fn sides_of_bevelled_block(bevel: f64) -> (Vec<Option<u32>>, usize) {
        let section = [
            [0.0, 0.0],
            [100.0, 0.0],
            [100.0, 100.0 - bevel],
            [100.0 - bevel, 100.0],
            [0.0, 100.0],
        ];
        let at = |y: f64| section.map(|[x, z]| (Point3::new(x, y, z) * PIXEL).cast());
        let points: Vec<Point3<f32>> = at(0.0).into_iter().chain(at(100.0)).collect();
        let mesh = convex_hull(&points).unwrap();
        let mut flat = Flat::of(&mesh, PIXEL);
        let sides: Vec<bool> = flat.planes.iter().map(|p| p.normal.amax() > 0.99).collect();
        flat.give_bevels_to_sides(&sides);
        let of_sides = |part: &u32| sides[*part as usize];
        let found = flat.of_facet.iter().map(|part| part.filter(of_sides));
        (found.collect(), sides.iter().filter(|s| **s).count())
    }

    #[test]
    fn a_narrow_strip_becomes_a_part_of_the_sides_and_a_wide_one_does_not() {
        let (narrow, sides) = sides_of_bevelled_block(3.0);
        assert_eq!(sides, 6);
        assert!(narrow.iter().all(Option::is_some));
        let (wide, _) = sides_of_bevelled_block(20.0);
        assert_eq!(wide.iter().filter(|side| side.is_none()).count(), 2);
    }
}
