//! The shape of the board's sheet as parameters of the fit: which of its terms are fitted, and their prior.

use super::Parameters;
use super::session::turns;
use crate::calibration::{Board, BoardShape, Face, Surface};
use nalgebra::{Matrix3, Point2, Point3};

/// Number of the shape's terms.
pub(super) const TERMS: usize = BoardShape::TERMS;

/// Which terms there are.
pub(super) type Mask = [bool; TERMS];

/// Assumed variance of a measured coordinate, in px². It scales the priors on lenses and sheet; for the sheet, the
/// variance of the residuals replaces it.
pub(super) const PRIOR_VARIANCE: f64 = 0.04;

/// The sheet's state.
#[derive(Clone, Debug)]
pub(super) struct Sheet {
    front: Surface,
    /// Whether the pattern maps onto itself by a quarter turn, so that nobody knows which direction is that of its
    /// rows. The terms of such a sheet are the mean of its bends, half their difference, and the stretch: the first
    /// alone is the same whichever way the board is read.
    looks_turned: bool,
    /// Which of the terms are fitted.
    pub free: Mask,
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
            looks_turned: turns(board).len() > 2,
            free: [false; TERMS],
            deviation: [1.0; TERMS],
            variance: PRIOR_VARIANCE,
        }
    }

    /// A flat sheet whose squares have the stated size.
    pub(super) fn flat(board: &Board) -> Self {
        Self::of(board, BoardShape::default())
    }

    /// A flat sheet with what is expected of its terms before anything is seen.
    pub(super) fn expected(board: &Board, parameters: &Parameters) -> Self {
        let mut sheet = Self::flat(board);
        let bend = 1e-3 * parameters.bend_expected_mm;
        // The mean of two independent bends, and half their difference, vary less than either.
        let bend = match sheet.looks_turned {
            true => bend * std::f64::consts::FRAC_1_SQRT_2,
            false => bend,
        };
        sheet.deviation = [bend, bend, 1e-2 * parameters.stretch_expected_percent];
        sheet
    }

    pub(super) fn shape(&self) -> BoardShape {
        self.front.shape()
    }

    /// The terms that are fitted.
    pub(super) fn terms(&self) -> [f64; TERMS] {
        let [along_rows, down_columns, stretch] = self.shape().terms();
        match self.looks_turned {
            true => [
                0.5 * (along_rows + down_columns),
                0.5 * (along_rows - down_columns),
                stretch,
            ],
            false => [along_rows, down_columns, stretch],
        }
    }

    /// Gives the sheet the shape of these terms.
    pub(super) fn set_terms(&mut self, [first, second, stretch]: [f64; TERMS]) {
        let [along_rows, down_columns] = match self.looks_turned {
            true => [first + second, first - second],
            false => [first, second],
        };
        let shape = BoardShape::of_terms([along_rows, down_columns, stretch]);
        self.front = self.front.with(shape);
    }

    /// Terms that do not depend on which direction is that of the rows, where nobody knows that.
    pub(super) fn knowable(&self) -> Mask {
        match self.looks_turned {
            true => [true, false, false],
            false => [true; TERMS],
        }
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
        let by = self.face(back).by_terms([p.x, p.y]);
        match self.looks_turned {
            true => Matrix3::from_columns(&[
                by.column(0) + by.column(1),
                by.column(0) - by.column(1),
                by.column(2).into_owned(),
            ]),
            false => by,
        }
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
        let terms = self.terms();
        let free = (0..TERMS).filter(|&i| self.free[i]);
        free.map(move |i| (i, self.variance / self.deviation[i].powi(2), terms[i]))
    }
}
