//! Readings in front of the faired hull: where a depth camera reads the object there, fairing went too deep. All doubt
//! speaks for the faired hull: noise and bias, what the depth changes in a pixel (a grazing view proves nothing), and
//! what lies within two pixels, so that neither a step in depth nor a single stray reading proves anything. A reading
//! in front of the plain hull, which contains the object, is not of this place.

use super::front::largest_change;
use super::segment::{dilate, erode};
use super::{Bias, BiasSource, HullRenderings, Parameters, stated_bias};
use crate::calibration::DepthCamera;
use crate::image::{Grid, Mask};
use crate::reconstruct::depth::EnhancedDepth;
use nalgebra::{Point2, Point3};

/// Standard errors of a reading by which it has to lie in front.
const NOISE: f32 = 3.0;
/// Pixels around a reading that have to lie in front, too.
const AROUND_PX: usize = 2;

/// What one depth camera read, and what it sees of the faired hull.
pub struct FairedHullView<'a> {
    /// The camera.
    pub camera: &'a DepthCamera,
    /// Its enhanced depth.
    pub depth: &'a EnhancedDepth,
    /// What is to be taken off the depth.
    pub bias: &'a Bias,
    /// The faired hull as the camera sees it.
    pub faired: &'a HullRenderings,
}

/// The points of the faired hull (in the scene's frame, row by row of the picture) in front of which the camera reads
/// the object; mostly none. `plain` renders the plain hull, which is needed only if there may be one.
pub fn read_in_front(
    view: &FairedHullView,
    plain: impl FnOnce() -> HullRenderings,
    parameters: &Parameters,
) -> Vec<Point3<f64>> {
    let bias = view.remaining_bias(parameters);
    let (width, height) = (view.depth.depth.width(), view.depth.depth.height());
    let is_in_front = |x, y| view.is_in_front(x, y, bias);
    let in_front = supported(&Grid::from_fn_parallel(width, height, is_in_front));
    if !in_front.pixels().contains(&true) {
        return Vec::new();
    }
    let plain = plain();
    let is_of_place = |x, y| in_front[(x, y)] && view.is_behind(&plain, x, y, bias);
    view.points(&supported(&Grid::from_fn(width, height, is_of_place)))
}

impl FairedHullView<'_> {
    /// Metres of bias that may be left. Only the table tells it by itself: from the hull it is estimated as if the
    /// plain hull touched the object, and what is read in front of a loose hull is then off by more.
    fn remaining_bias(&self, parameters: &Parameters) -> f32 {
        let remaining = self.bias.remaining;
        let bias = match self.bias.source {
            BiasSource::Table => remaining,
            BiasSource::Hull | BiasSource::None => {
                remaining.max(stated_bias(self.camera, parameters))
            }
        };
        bias as f32
    }

    /// Depth of a pixel's reading in metres, less its bias; infinite where there is none.
    fn read(&self, x: isize, y: isize) -> f32 {
        let depth = self.depth.reading(x, y);
        depth.map_or(f32::INFINITY, |depth| depth - self.bias.metres as f32)
    }

    /// By how many metres a pixel's reading may be off.
    fn doubt(&self, x: usize, y: usize, bias: f32) -> f32 {
        NOISE * self.depth.sigma[(x, y)] + bias
    }

    /// Whether a pixel's reading lies in front of the faired hull for certain.
    fn is_in_front(&self, x: usize, y: usize, bias: f32) -> bool {
        let (column, row) = (x as isize, y as isize);
        let (read, surface) = (self.read(column, row), self.faired.depth[(x, y)]);
        if !read.is_finite() || !surface.is_finite() {
            return false;
        }
        let of_reading = largest_change(column, row, |x, y| self.read(x, y));
        let change = self.faired.largest_change(x, y).max(of_reading);
        read + self.doubt(x, y, bias) + change < surface
    }

    /// Whether a pixel's reading may lie behind the front of the plain hull.
    fn is_behind(&self, plain: &HullRenderings, x: usize, y: usize, bias: f32) -> bool {
        self.read(x as isize, y as isize) + self.doubt(x, y, bias) > plain.depth[(x, y)]
    }

    /// The points of the faired hull that some pixels see.
    fn points(&self, pixels: &Grid<bool>) -> Vec<Point3<f64>> {
        let mut points = Vec::new();
        for y in 0..pixels.height() {
            for x in (0..pixels.width()).filter(|&x| pixels[(x, y)]) {
                let pixel = Point2::new(x as f64, y as f64);
                let depth = f64::from(self.faired.depth[(x, y)]);
                points.extend(self.camera.point(pixel, depth));
            }
        }
        points
    }
}

/// The pixels of a mask that lie in a part of it that is [`AROUND_PX`] wide on all sides of a pixel.
fn supported(mask: &Grid<bool>) -> Grid<bool> {
    let mut mask: Mask = mask.map(|&is_set| if is_set { 255 } else { 0 });
    for _ in 0..AROUND_PX {
        mask = erode(&mask);
    }
    for _ in 0..AROUND_PX {
        mask = dilate(&mask);
    }
    mask.map(|&value| value != 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::depth::DepthKind;
    use crate::reconstruct::testing::{camera, evidence};

    const SIDE: usize = 40;
    /// Depths of the plain hull's and of the faired hull's front, in metres. A reading is off by 3 mm at most, as
    /// `evidence` has it.
    const PLAIN: f32 = 0.70;
    const FAIRED: f32 = 0.71;

    /// A camera above a faired hull, and what it read.
    struct Seen {
        camera: DepthCamera,
        depth: EnhancedDepth,
        bias: Bias,
        faired: HullRenderings,
    }

    impl Seen {
        /// It reads `depth` metres in the middle, on so many pixels a row, and the faired hull around them; of its
        /// bias, which the table shows, nothing is left.
        fn reads(depth: f32, pixels: usize) -> Self {
            let (mut enhanced, regions) = evidence(FAIRED, Grid::filled(SIDE, SIDE, 0));
            let first = SIDE / 2 - pixels / 2;
            let middle = first..first + pixels;
            enhanced.depth = Grid::from_fn(SIDE, SIDE, |x, y| {
                let is_middle = middle.contains(&x) && middle.contains(&y);
                if is_middle { depth } else { FAIRED }
            });
            Self {
                camera: camera(SIDE, 0.8),
                depth: enhanced,
                bias: Bias {
                    source: BiasSource::Table,
                    ..regions.bias
                },
                faired: level(FAIRED),
            }
        }

        fn points(&self) -> Vec<Point3<f64>> {
            let view = FairedHullView {
                camera: &self.camera,
                depth: &self.depth,
                bias: &self.bias,
                faired: &self.faired,
            };
            read_in_front(&view, || level(PLAIN), &Parameters::default())
        }
    }

    /// A hull whose front is at one depth everywhere.
    fn level(depth: f32) -> HullRenderings {
        HullRenderings {
            depth: Grid::filled(SIDE, SIDE, depth),
            exit: Grid::filled(SIDE, SIDE, 0.9),
            is_front: Grid::filled(SIDE, SIDE, true),
        }
    }

    #[test]
    fn what_is_read_between_the_plain_hull_and_the_faired_one_shows_that_fairing_went_too_deep() {
        let points = Seen::reads(0.705, 12).points();
        // Ten pixels a row are left without those beside the step, and of these all but the three in each corner.
        assert_eq!(points.len(), 100 - 4 * 3);
        // They lie on the faired hull, in front of the reading's place.
        let half_a_row = 0.5 * 10.0 * f64::from(FAIRED) / 575.0;
        for p in &points {
            assert!((p.z - (0.8 - f64::from(FAIRED))).abs() < 1e-6, "{p}");
            assert!(p.x.abs().max(p.y.abs()) < half_a_row + 1e-3, "{p}");
        }
    }

    #[test]
    fn a_reading_within_its_doubt_of_the_faired_hull_or_behind_it_shows_nothing() {
        for depth in [0.7075, 0.71, 0.72] {
            assert!(Seen::reads(depth, 12).points().is_empty(), "{depth}");
        }
    }

    #[test]
    fn a_reading_in_front_of_the_plain_hull_is_not_of_this_place() {
        assert!(Seen::reads(0.69, 12).points().is_empty());
        // Within its noise it may be of it.
        assert!(!Seen::reads(0.698, 12).points().is_empty());
    }

    #[test]
    fn stray_readings_and_those_beside_a_step_show_nothing() {
        for pixels in 1..=6 {
            assert!(Seen::reads(0.705, pixels).points().is_empty(), "{pixels}");
        }
        assert!(!Seen::reads(0.705, 7).points().is_empty());
        // The faired hull has a step in each second column, and one side of each is beneath the reading.
        let mut seen = Seen::reads(0.705, 12);
        seen.faired.depth = Grid::from_fn(SIDE, SIDE, |x, _| FAIRED + 6e-3 * (x % 2) as f32);
        assert!(seen.points().is_empty());
    }

    #[test]
    fn a_pixel_without_a_reading_shows_nothing_and_neither_do_those_around_it() {
        let mut seen = Seen::reads(0.705, 9);
        let middle = SIDE / 2;
        for kind in [DepthKind::Filled, DepthKind::None] {
            seen.depth.kind[(middle, middle)] = kind;
            assert!(seen.points().is_empty(), "{kind:?}");
        }
    }

    #[test]
    fn on_a_grazing_view_a_reading_has_to_be_in_front_by_what_the_depth_changes_in_a_pixel() {
        let shows_nothing = |change: f32| {
            let mut seen = Seen::reads(0.705, SIDE);
            let fall = |x: usize| change * (x as f32 - 20.0);
            seen.depth.depth = Grid::from_fn(SIDE, SIDE, |x, _| 0.705 + fall(x));
            seen.faired.depth = Grid::from_fn(SIDE, SIDE, |x, _| FAIRED + fall(x));
            seen.points().is_empty()
        };
        // Farther to the left it lies in front of the plain hull.
        assert!(!shows_nothing(1e-3));
        assert!(shows_nothing(2.5e-3));
    }

    #[test]
    fn the_bias_that_may_be_left_speaks_for_the_faired_hull() {
        let with = |bias: Bias| Seen {
            bias,
            ..Seen::reads(0.705, 12)
        };
        let known = Seen::reads(0.705, 12).bias;
        let left = |metres| Bias {
            remaining: metres,
            ..known
        };
        assert!(!with(left(1e-3)).points().is_empty());
        assert!(with(left(3e-3)).points().is_empty());
        // What a camera is known to read too near is none of it.
        let too_near = Bias {
            metres: -5e-3,
            ..known
        };
        assert!(with(too_near).points().is_empty());
        // Without the table it may be as large as a camera's bias may be that states none.
        for source in [BiasSource::Hull, BiasSource::None] {
            let unsure = with(Bias { source, ..known });
            assert!(unsure.points().is_empty(), "{source:?}");
        }
    }
}
