//! The shape of the board's sheet as parameters of the fit: which of its terms are fitted, and their prior.

use crate::calibration::{Board, BoardShape, Face, Surface};
use nalgebra::{Matrix3, Point2, Point3};

/// Number of the shape's terms.
pub(super) const TERMS: usize = BoardShape::TERMS;

/// Assumed variance of a measured coordinate, in px². It scales the priors on lenses and sheet; for the sheet, the
/// variance of the residuals replaces it.
pub(super) const PRIOR_VARIANCE: f64 = 0.04;

/// The sheet's state.
#[derive(Clone, Debug)]
pub(super) struct Sheet {
    front: Surface,
    /// Which of the shape's terms are fitted.
    pub free: [bool; TERMS],
    /// Standard deviation of each term before anything is seen; each is believed to be 0.
    pub deviation: [f64; TERMS],
    /// Variance in px² of a coordinate that this prior is weighed against.
    pub variance: f64,
}

impl Sheet {
    /// A sheet of a known shape.
    pub(super) fn of(board: &Board, shape: BoardShape) -> Self {
        Self {
            front: Surface::new(board, Face::Front, shape),
            free: [false; TERMS],
            deviation: [1.0; TERMS],
            variance: PRIOR_VARIANCE,
        }
    }

    /// A flat sheet whose squares have the stated size.
    pub(super) fn flat(board: &Board) -> Self {
        Self::of(board, BoardShape::default())
    }

    pub(super) fn shape(&self) -> BoardShape {
        self.front.shape()
    }

    pub(super) fn set(&mut self, shape: BoardShape) {
        self.front = self.front.with(shape);
    }

    /// One of its faces.
    #[inline]
    pub(super) fn face(&self, back: bool) -> Surface {
        match back {
            true => self.front.other_side(),
            false => self.front,
        }
    }

    /// The true position, in the face's frame, of a stated point of a face.
    #[inline]
    pub(super) fn point(&self, back: bool, p: &Point3<f64>) -> Point3<f64> {
        self.face(back).point([p.x, p.y])
    }

    /// Derivatives of [`Self::point`] by the terms.
    #[inline]
    pub(super) fn by_terms(&self, back: bool, p: &Point3<f64>) -> Matrix3<f64> {
        self.face(back).by_terms([p.x, p.y])
    }

    /// Pairs of points and pixels with the points where they really lie.
    pub(super) fn shaped(
        &self,
        back: bool,
        pairs: &[(Point3<f64>, Point2<f64>)],
    ) -> Vec<(Point3<f64>, Point2<f64>)> {
        let face = self.face(back);
        let shaped = |(p, pixel): &(Point3<f64>, Point2<f64>)| (face.point([p.x, p.y]), *pixel);
        pairs.iter().map(shaped).collect()
    }

    /// What the terms that are fitted are believed to be: index, weight, and how far they are from it.
    pub(super) fn priors(&self) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let terms = self.shape().terms();
        let free = (0..TERMS).filter(|&i| self.free[i]);
        free.map(move |i| (i, self.variance / self.deviation[i].powi(2), terms[i]))
    }
}
