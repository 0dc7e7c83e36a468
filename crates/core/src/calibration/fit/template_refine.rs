//! Refines corners that lie close to markers. A first fit shows how the board lies, so the printed pattern around such
//! a corner can be matched with the picture; marker edges then contribute to the match instead of biasing it. It finds
//! no board and fits no lens.

use super::result::Fit;
use super::session::{Corner, Session, View};
use super::subpixel;
use super::template::Template;
use crate::calibration::{Board, BoardKind, Face, Intrinsics, Rectangle, Surface};
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
/// Farthest, in pixels, that a corner may be from where the first fit has it.
const LARGEST_MOVE: f64 = 1.5;
/// Largest root mean square residual of a match, as a share of the contrast between paper and ink.
const MOST_LEFT: f64 = 0.15;

/// Views of a session in which markers crowd a corner: what a second look at their pictures makes better.
pub fn crowded_views(session: &Session) -> Vec<usize> {
    let is_crowded = |view: &View| match session.board.kind {
        BoardKind::Checkerboard => false,
        BoardKind::Charuco(_) => {
            let size = session.cameras[view.camera].size;
            subpixel::crowded(size, &view.corners, &session.board)
        }
    };
    let all = session.views.iter().enumerate();
    all.filter(|(_, view)| is_crowded(view))
        .map(|(index, _)| index)
        .collect()
}

/// The corners of a view where the print says that they are; those around which something else is seen are left out,
/// but where that is most of them all stay where they were found. `None` for a view whose camera or placement the first
/// fit does not know.
pub fn matched_with_print(
    session: &Session,
    fit: &Fit,
    view: &View,
    picture: &Grid<u8>,
) -> Option<Vec<Corner>> {
    let print = Print::seen(session, fit, view)?;
    let at = |corner: &Corner| {
        let pixel = print.matched(picture, corner)?;
        Some(Corner { pixel, ..*corner })
    };
    let matched: Vec<Corner> = view.corners.iter().filter_map(at).collect();
    let is_most = 2 * matched.len() > view.corners.len();
    Some(if is_most {
        matched
    } else {
        view.corners.clone()
    })
}

/// A face of the board before a camera.
struct Print<'a> {
    board: &'a Board,
    /// Which squares are black.
    black: Vec<Vec<Rectangle>>,
    lens: &'a Intrinsics,
    surface: Surface,
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
            surface: Surface::new(&session.board, view.face, fit.shape.shape()),
            camera_from_face,
        })
    }

    /// Where a stated point of the face is seen.
    fn pixel(&self, on_face: Point3<f64>) -> Option<Point2<f64>> {
        let p = self.camera_from_face * self.surface.point([on_face.x, on_face.y]);
        self.lens.project(p.x, p.y, p.z)
    }

    /// Where a pixel's ray meets the face.
    fn on_face(&self, pixel: Point2<f64>) -> Option<Point2<f64>> {
        let direction = self.lens.unproject(pixel)?;
        let pose = &self.camera_from_face;
        let ray = pose.inverse_transform_vector(&Vector3::new(direction.x, direction.y, 1.0));
        let eye = pose.inverse_transform_point(&Point3::origin());
        self.surface.intersect(eye, ray).map(Point2::from)
    }

    /// Pixels from a corner to the next one, in the direction in which they are nearest.
    fn square_px(&self, corner: &Corner, at: Point2<f64>) -> Option<f64> {
        let on_face = self.board.corner_position(corner.column, corner.row);
        let step = |by: Vector3<f64>| Some((self.pixel(on_face + by)? - at).norm());
        let square = self.board.square;
        let steps = [step(Vector3::x() * square)?, step(Vector3::y() * square)?];
        Some(steps[0].min(steps[1]))
    }

    /// Where a corner is according to the printed pattern; `None` if the pattern does not match the picture.
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
        let shift = matching(&template, &shown)?;
        Some(predicted + shift)
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

/// How far to move the template so that it matches the picture: least squares in the shift, the variance of the
/// spread, and the light of paper and ink.
fn matching(template: &Template, shown: &Grid<f64>) -> Option<Vector2<f64>> {
    let (mut shift, mut spread) = (Vector2::zeros(), USUAL_SPREAD);
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
        if shift.norm() > LARGEST_MOVE || spread.is_nan() {
            return None;
        }
        if moved.norm() < STILL {
            let is_sharp = (SPREADS[0]..=SPREADS[1]).contains(&spread);
            return (is_like && is_sharp).then_some(shift);
        }
    }
    None
}

/// The brightness of paper and the contrast of ink that fit the picture best.
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

#[cfg(test)]
mod tests {
    use super::super::synthetic::{color_lens, looking, placed};
    use super::*;
    use crate::calibration::BoardShape;

    #[test]
    fn a_picture_of_something_else_matches_nothing() {
        let board: Board = "charuco:9x6:25mm:two-sided".parse().unwrap();
        let (lens, middle) = (color_lens(), Point3::new(0.0, 0.0, 0.1));
        let camera = looking("c00", lens, Point3::new(0.6, 0.0, 0.5), middle);
        let pose = placed(&board, middle, Vector3::zeros(), 0.3);
        let print = Print {
            board: &board,
            black: board.black_by_square(Face::Front),
            lens: &lens,
            surface: Surface::new(&board, Face::Front, BoardShape::default()),
            camera_from_face: camera.rig_from_camera.inverse() * pose,
        };
        let flat = Grid::filled(lens.width, lens.height, 120);
        let stripes = Grid::from_fn(lens.width, lens.height, |x, _| {
            if x / 9 % 2 == 0 { 60 } else { 200 }
        });
        let pixel = Point2::origin();
        for (column, row) in [(0, 0), (4, 3), (8, 5)] {
            let corner = Corner { column, row, pixel };
            let on_face = board.corner_position(column, row);
            let predicted = print.pixel(on_face).unwrap();
            assert!(shown(&flat, predicted, LARGEST_WINDOW as usize).is_some());
            assert_eq!(print.matched(&flat, &corner), None);
            assert_eq!(print.matched(&stripes, &corner), None);
        }
    }
}
