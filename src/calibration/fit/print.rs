//! Corners that markers crowd, taken from the print itself: a first fit says how the board lies, so what is printed around
//! such a corner can be laid over the picture until both agree. The markers' ink is then evidence and pulls nothing. It
//! finds no board and fits no lens.

use super::polish;
use super::result::Fit;
use super::session::{Corner, Session, View};
use super::template::Template;
use crate::calibration::{Board, BoardKind, Face, Intrinsics, Rectangle};
use crate::image::{Grid, srgb};
use nalgebra::{Isometry3, Matrix5, Point2, Point3, Vector2, Vector3, Vector5};

/// Half a window's side over the distance of the next corner, and in pixels.
const WINDOW_PART: f64 = 0.5;
const SMALLEST_WINDOW: f64 = 4.0;
const LARGEST_WINDOW: f64 = 14.0;
/// Variance of the point spread in px² from which a match starts, and between which it is looked for.
const USUAL_SPREAD: f64 = 0.8;
const SPREADS: [f64; 2] = [0.15, 4.0];
/// Most steps of a match, and the step in pixels that counts as none.
const STEPS: usize = 20;
const STILL: f64 = 1e-3;
/// Farthest, in pixels, that a corner may be from where it was found.
const LARGEST_MOVE: f64 = 1.5;
/// Root mean square of what a match may leave, as a part of the contrast between paper and ink.
const MOST_LEFT: f64 = 0.15;

/// Views of a session in which markers crowd a corner: what a second look at their pictures makes better.
pub fn crowded_views(session: &Session) -> Vec<usize> {
    let is_crowded = |view: &View| crowded(session, view).contains(&true);
    let all = session.views.iter().enumerate();
    all.filter(|(_, view)| is_crowded(view))
        .map(|(index, _)| index)
        .collect()
}

/// Whether each corner of a view is crowded by markers.
fn crowded(session: &Session, view: &View) -> Vec<bool> {
    match session.board.kind {
        BoardKind::Checkerboard => vec![false; view.corners.len()],
        BoardKind::Charuco(_) => {
            let size = session.cameras[view.camera].size;
            polish::crowded(size, &view.corners, &session.board)
        }
    }
}

/// The corners of a view, those that markers crowd where the print says that they are. `None` for a view whose camera or
/// placement the first fit does not know.
pub fn matched_with_print(
    session: &Session,
    fit: &Fit,
    view: &View,
    picture: &Grid<u8>,
) -> Option<Vec<Corner>> {
    let print = Print::seen(session, fit, view)?;
    let mut corners = view.corners.clone();
    for (corner, is_crowded) in corners.iter_mut().zip(crowded(session, view)) {
        if let Some(at) = is_crowded.then(|| print.matched(picture, corner)).flatten() {
            corner.pixel = at;
        }
    }
    Some(corners)
}

/// A face of the board before a camera.
struct Print<'a> {
    board: &'a Board,
    /// What is black, by square.
    black: Vec<Vec<Rectangle>>,
    lens: &'a Intrinsics,
    camera_from_face: Isometry3<f64>,
}

impl<'a> Print<'a> {
    fn seen(session: &'a Session, fit: &'a Fit, view: &View) -> Option<Self> {
        let id = &session.cameras[view.camera].id;
        let camera = &fit.cameras.iter().find(|c| c.camera.id == *id)?.camera;
        let name = &session.placements[view.placement];
        let placement = fit.placements.iter().find(|p| p.name == *name)?;
        let front = camera.rig_from_camera.inverse() * placement.rig_from_board;
        let camera_from_face = match view.face {
            Face::Front => front,
            Face::Back => front * fit.front_from_back,
        };
        Some(Self {
            board: &session.board,
            black: session.board.black_by_square(view.face),
            lens: &camera.intrinsics,
            camera_from_face,
        })
    }

    /// Where a point of the face is seen.
    fn pixel(&self, on_face: Point3<f64>) -> Option<Point2<f64>> {
        let p = self.camera_from_face * on_face;
        self.lens.project(p.x, p.y, p.z)
    }

    /// Where a pixel's ray meets the face.
    fn on_face(&self, pixel: Point2<f64>) -> Option<Point2<f64>> {
        let direction = self.lens.unproject(pixel)?;
        let pose = &self.camera_from_face;
        let ray = pose.inverse_transform_vector(&Vector3::new(direction.x, direction.y, 1.0));
        let eye = pose.inverse_transform_point(&Point3::origin());
        Some((eye - ray * (eye.z / ray.z)).xy())
    }

    /// Pixels from a corner to the next one, in the direction in which they are nearest.
    fn square_px(&self, corner: &Corner, at: Point2<f64>) -> Option<f64> {
        let on_face = self.board.corner_position(corner.column, corner.row);
        let step = |by: Vector3<f64>| Some((self.pixel(on_face + by)? - at).norm());
        let square = self.board.square;
        let steps = [step(Vector3::x() * square)?, step(Vector3::y() * square)?];
        Some(steps[0].min(steps[1]))
    }

    /// Where the print says that a corner is; `None` where it does not match what is seen.
    fn matched(&self, picture: &Grid<u8>, corner: &Corner) -> Option<Point2<f64>> {
        let predicted = self.pixel(self.board.corner_position(corner.column, corner.row))?;
        let half = WINDOW_PART * self.square_px(corner, predicted)?;
        if half < SMALLEST_WINDOW {
            return None;
        }
        let half = half.min(LARGEST_WINDOW) as usize;
        let shown = shown(picture, predicted, half)?;
        let first = predicted.map(|v| v.round()) - Vector2::repeat(half as f64);
        let template = Template::new(first, shown.width(), |pixel| self.on_face(pixel))?
            .painted(self.board, &self.black);
        let found = matching(&template, &shown, corner.pixel - predicted)?;
        let at = predicted + found;
        ((at - corner.pixel).norm() <= LARGEST_MOVE).then_some(at)
    }
}

/// Linear light of a picture around a place; `None` beyond its border.
fn shown(picture: &Grid<u8>, around: Point2<f64>, half: usize) -> Option<Grid<f64>> {
    let [x, y] = [around.x, around.y].map(|v| v.round() as isize - half as isize);
    let side = 2 * half + 1;
    let end = [x, y].map(|v| v + side as isize);
    let [width, height] = [picture.width(), picture.height()].map(|v| v as isize);
    let inside = x >= 0 && y >= 0 && end[0] <= width && end[1] <= height;
    let linear = srgb::linear_from_srgb();
    inside.then(|| {
        Grid::from_fn(side, side, |i, j| {
            let value = picture[(x as usize + i, y as usize + j)];
            f64::from(linear[usize::from(value)])
        })
    })
}

/// By how much the template is to be moved to match what is shown: least squares in the shift, the variance of the
/// spread, and the light of paper and ink.
fn matching(template: &Template, shown: &Grid<f64>, start: Vector2<f64>) -> Option<Vector2<f64>> {
    let (mut shift, mut spread) = (start, USUAL_SPREAD);
    let [mut paper, mut contrast] = light(template, shown, shift, spread)?;
    for _ in 0..STEPS {
        let (mut matrix, mut right, mut left) = (Matrix5::zeros(), Vector5::zeros(), 0.0);
        let expected = template.spread(shift, spread);
        for (pixel, value) in expected.iter().zip(shown.pixels()) {
            let error = value - paper - contrast * pixel.ink;
            let by = Vector5::new(
                contrast * pixel.by_x,
                contrast * pixel.by_y,
                contrast * pixel.by_spread,
                1.0,
                pixel.ink,
            );
            matrix += by * by.transpose();
            right += by * error;
            left += error * error;
        }
        let step = matrix.cholesky()?.solve(&right);
        let moved = Vector2::new(step[0], step[1]).cap_magnitude(0.5);
        shift += moved;
        spread = (spread + step[2]).clamp(0.5 * spread, 2.0 * spread);
        (paper, contrast) = (paper + step[3], contrast + step[4]);
        let is_like = (left / shown.pixels().len() as f64).sqrt() <= MOST_LEFT * -contrast;
        if shift.norm() > 2.0 * LARGEST_MOVE || spread.is_nan() {
            return None;
        }
        if moved.norm() < STILL {
            let is_sharp = (SPREADS[0]..=SPREADS[1]).contains(&spread);
            return (is_like && is_sharp).then_some(shift);
        }
    }
    None
}

/// Light of paper, and of ink beyond it, that explains best what is shown.
fn light(
    template: &Template,
    shown: &Grid<f64>,
    shift: Vector2<f64>,
    spread: f64,
) -> Option<[f64; 2]> {
    let expected = template.spread(shift, spread);
    let count = expected.len() as f64;
    let [mut ink, mut value, mut both, mut squares] = [0.0; 4];
    for (pixel, shown) in expected.iter().zip(shown.pixels()) {
        ink += pixel.ink;
        value += shown;
        both += pixel.ink * shown;
        squares += pixel.ink * pixel.ink;
    }
    let contrast = (both - ink * value / count) / (squares - ink * ink / count);
    contrast
        .is_finite()
        .then(|| [(value - contrast * ink) / count, contrast])
}
