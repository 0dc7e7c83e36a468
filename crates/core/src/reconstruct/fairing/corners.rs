//! The fewest points of certain edges that explain the outlines: the corners of the edges' convex hull. Knows pictures
//! as a camera without distortion would see them.

use super::contour::Contour;
use nalgebra::{Point2, Point3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A corner without which no outline would retreat by so many pixels is left out.
const NEEDED_PX: f64 = 0.6;

/// Those of the points that the outlines of their convex hull need: without them one would retreat by more than a
/// fraction of a pixel. Points that only seem to be on an edge lie in front of a side where no outline shows them.
pub(super) fn needed(points: &[Point3<f64>], contours: &[Contour]) -> Vec<Point3<f32>> {
    let pictures: Vec<Vec<Point2<f64>>> = contours
        .iter()
        .filter_map(|contour| pictures(points, contour))
        .collect();
    let mut left: Vec<u32> = (0..points.len() as u32).collect();
    let outline_of = |picture: &Vec<Point2<f64>>, left: &[u32]| {
        outline(left.iter().map(|&v| (v, picture[v as usize])).collect())
    };
    let mut outlines: Vec<Vec<(u32, Point2<f64>)>> = pictures
        .par_iter()
        .map(|picture| outline_of(picture, &left))
        .collect();
    loop {
        // How far some outline would retreat without each point.
        let mut retreats: BTreeMap<u32, f64> = BTreeMap::new();
        for outline in &outlines {
            for (i, &(v, p)) in outline.iter().enumerate() {
                let before = outline[(i + outline.len() - 1) % outline.len()].1;
                let after = outline[(i + 1) % outline.len()].1;
                let retreat = retreats.entry(v).or_insert(0.0);
                *retreat = retreat.max(distance(p, before, after));
            }
        }
        left = retreats.keys().copied().collect();
        let least = retreats.iter().min_by(|a, b| a.1.total_cmp(b.1));
        let removed = match least {
            Some((&v, &retreat)) if retreat < NEEDED_PX => v,
            _ => break,
        };
        left.retain(|&other| other != removed);
        // An outline that the point is not on stays as it is.
        outlines
            .par_iter_mut()
            .zip(&pictures)
            .filter(|(outline, _)| outline.iter().any(|(v, _)| *v == removed))
            .for_each(|(outline, picture)| *outline = outline_of(picture, &left));
    }
    left.iter().map(|&v| points[v as usize].cast()).collect()
}

/// Where a camera without distortion would see points, in pixels from its axis; `None` where one is behind it.
pub(super) fn pictures(points: &[Point3<f64>], contour: &Contour) -> Option<Vec<Point2<f64>>> {
    let focal = contour.camera.intrinsics.focal_px;
    let picture = |p: &Point3<f64>| {
        let q = contour.camera.camera_from_rig(*p);
        (q.z > 0.0).then(|| Point2::new(q.x / q.z * focal.x, q.y / q.z * focal.y))
    };
    points.iter().map(picture).collect()
}

/// The convex polygon around points, counter-clockwise.
pub(super) fn outline(mut points: Vec<(u32, Point2<f64>)>) -> Vec<(u32, Point2<f64>)> {
    points.sort_by(|a, b| a.1.x.total_cmp(&b.1.x).then(a.1.y.total_cmp(&b.1.y)));
    let mut outline = chain(points.iter());
    outline.pop();
    outline.extend(chain(points.iter().rev()));
    outline.pop();
    outline
}

/// One half of a convex polygon, from points that are sorted (Andrew's monotone chain).
fn chain<'a>(points: impl Iterator<Item = &'a (u32, Point2<f64>)>) -> Vec<(u32, Point2<f64>)> {
    let mut chain: Vec<(u32, Point2<f64>)> = Vec::new();
    for point in points {
        while let [.., a, b] = chain[..]
            && (b.1 - a.1).perp(&(point.1 - b.1)) <= 0.0
        {
            chain.pop();
        }
        chain.push(*point);
    }
    chain
}

/// Distance of a point to a line between two others.
pub(super) fn distance(p: Point2<f64>, a: Point2<f64>, b: Point2<f64>) -> f64 {
    let along = b - a;
    let t = (p - a).dot(&along) / along.norm_squared().max(1e-12);
    (p - (a + along * t.clamp(0.0, 1.0))).norm()
}
