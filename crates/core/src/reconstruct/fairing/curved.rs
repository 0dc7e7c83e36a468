//! The curved surface through a mesh with normals: Phong tessellation (Boubekeur and Alexa 2008). Knows no camera and
//! no lattice.

use super::shape::{Shape, corner_normals};
use crate::array::three;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Faces that meet at a sharper angle than this do not share a normal.
const CREASE_COSINE: f64 = 0.87;

/// A mesh with a normal for each corner of each triangle.
pub(super) struct Curved {
    pub(super) positions: Vec<Point3<f64>>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Unit normal of the surface at each triangle's corners: one for both sides, but at creases.
    pub(super) corners: Vec<[Vector3<f64>; 3]>,
    /// Unit normal at each vertex, over all faces around it: it tells inside from outside.
    pub(super) pseudo: Vec<Vector3<f64>>,
    /// Unit normal of each triangle; zero without area.
    pub(super) faces: Vec<Vector3<f64>>,
}

impl Curved {
    /// The surface of a mesh as it is now.
    pub(super) fn new(shape: &Shape) -> Self {
        let (positions, triangles) = (shape.positions.clone(), shape.triangles.clone());
        let shares: Vec<[Vector3<f64>; 3]> = triangles
            .par_iter()
            .map(|t| corner_normals(three(|i| positions[t[i] as usize])))
            .collect();
        let mut starts = vec![0_u32; positions.len() + 1];
        for &v in triangles.as_flattened() {
            starts[v as usize + 1] += 1;
        }
        for v in 0..positions.len() {
            starts[v + 1] += starts[v];
        }
        // For each vertex the shares of the triangles around it.
        let mut around = vec![Vector3::zeros(); starts[positions.len()] as usize];
        let mut next = starts.clone();
        for (t, shares) in triangles.iter().zip(&shares) {
            for i in 0..3 {
                let next = &mut next[t[i] as usize];
                around[*next as usize] = shares[i];
                *next += 1;
            }
        }
        let of = |v: u32| &around[starts[v as usize] as usize..starts[v as usize + 1] as usize];
        let unit = |v: Vector3<f64>| v.try_normalize(1e-12).unwrap_or_else(Vector3::z);
        let pseudo: Vec<Vector3<f64>> = (0..positions.len() as u32)
            .map(|v| unit(of(v).iter().sum()))
            .collect();
        let faces: Vec<Vector3<f64>> = shares
            .iter()
            .map(|s| s[0].try_normalize(1e-12).unwrap_or_else(Vector3::zeros))
            .collect();
        let smooth = |t: usize| {
            three(|i| {
                let alike = of(triangles[t][i]).iter().filter(|share| {
                    let cosine = share.dot(&faces[t]);
                    cosine > CREASE_COSINE * share.norm()
                });
                let sum: Vector3<f64> = alike.sum();
                sum.try_normalize(1e-12)
                    .unwrap_or(pseudo[triangles[t][i] as usize])
            })
        };
        let corners = (0..triangles.len()).into_par_iter().map(smooth).collect();
        Self {
            positions,
            triangles,
            corners,
            pseudo,
            faces,
        }
    }

    /// The three corners of a triangle.
    pub(super) fn places(&self, t: usize) -> [Point3<f64>; 3] {
        three(|i| self.positions[self.triangles[t][i] as usize])
    }

    /// A point of the curved surface, given a triangle and the weights of its corners.
    pub(super) fn point(&self, t: usize, weights: [f64; 3]) -> Point3<f64> {
        let corners = self.places(t);
        let flat = mix(weights, |i| corners[i].coords);
        let lifted = mix(weights, |i| {
            let n = self.corners[t][i];
            n * n.dot(&(corners[i].coords - flat))
        });
        Point3::from(flat + lifted * 0.5)
    }

    /// How far the curved surface lies outside the flat triangle along the normal, at the same place.
    pub(super) fn bulge(&self, t: usize, weights: [f64; 3], flat: Point3<f64>) -> f64 {
        let corners = self.places(t);
        let height = |i: usize| self.corners[t][i].dot(&(corners[i] - flat));
        0.5 * (weights[0] * height(0) + weights[1] * height(1) + weights[2] * height(2))
    }

    /// The unit normal of the curved surface.
    pub(super) fn normal(&self, t: usize, weights: [f64; 3]) -> Vector3<f64> {
        let mixed = mix(weights, |i| self.corners[t][i]);
        mixed.try_normalize(1e-12).unwrap_or(self.faces[t])
    }
}

/// The weights of a triangle's corners at a point of it.
pub(super) fn weights([a, b, c]: [Point3<f64>; 3], p: Point3<f64>) -> [f64; 3] {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (aa, cc, bc) = (ab.norm_squared(), ac.norm_squared(), ab.dot(&ac));
    let (pb, pc) = (ap.dot(&ab), ap.dot(&ac));
    let area = aa * cc - bc * bc;
    if area <= 1e-9 * aa.max(cc).powi(2) {
        return [1.0, 0.0, 0.0];
    }
    let second = ((cc * pb - bc * pc) / area).clamp(0.0, 1.0);
    let third = ((aa * pc - bc * pb) / area).clamp(0.0, 1.0 - second);
    [1.0 - second - third, second, third]
}

fn mix(weights: [f64; 3], value: impl Fn(usize) -> Vector3<f64>) -> Vector3<f64> {
    value(0) * weights[0] + value(1) * weights[1] + value(2) * weights[2]
}
