//! Free space: pixels on which a depth camera sees the table, a far wall or a part of the object through what the hull
//! claims, such as below a tray's rim. Such a reading is evidence wherever it is, also where the hull faces away or
//! where there is no hollow to start a region. It has to pass deeper than all that may be wrong with it and with the
//! hull, and has to lie behind straight lines between readings of the object. On a convex body none does: a reading of
//! the body lies on no such line's far side, and a ray that misses the body passes beside all of them.

use super::segment::{connected, erode, fill_enclosed};
use super::{Parameters, Regions, hollow, on_object};
use crate::image::{Grid, Mask};
use crate::reconstruct::depth::{DepthKind, EnhancedDepth};
use nalgebra::Point2;

/// Pixels by which the outline of what was read may be off the true one: a reading counts as the object's, and a group
/// of pixels as wide, only so far within its outline.
const RAGGED_PX: usize = 2;

/// A pixel of a depth camera, and a depth there in metres.
pub type DepthPixel = (Point2<f64>, f64);

/// What a reading has to exceed before it shows that the hull claims free space.
pub struct Doubt<'a> {
    /// Metres of bias that the depth may have: what the recording states, or what is assumed where it states none
    /// ([`super::stated_bias`]).
    pub bias: f64,
    /// How many pixels must agree.
    pub least_pixels: usize,
    /// The expected error of the hull, from silhouettes alone, at pixels with the depth of the hull's front: metres of
    /// depth for each of them.
    pub hull_errors: &'a dyn Fn(&[DepthPixel]) -> Vec<f64>,
}

/// Adds the free space that one depth camera sees to its regions, as regions with numbers above
/// [`Regions::last_hollow`]. `object` are the pixels that the object can cover. Pixels of other regions stay theirs.
pub fn add_free_space(
    regions: &mut Regions,
    depth: &EnhancedDepth,
    object: &Mask,
    doubt: &Doubt,
    parameters: &Parameters,
) {
    let bias = doubt.bias.max(regions.bias.remaining);
    let excess = excess(regions, depth, bias, parameters);
    let deeper = |kind: DepthKind| {
        Grid::from_fn(excess.width(), excess.height(), |x, y| {
            excess[(x, y)] > 0.0 && depth.kind[(x, y)] == kind
        })
    };
    let read = deeper(DepthKind::Measured);
    if wide_groups(&read, doubt.least_pixels).is_empty() {
        return;
    }
    let rims = shrunk(&on_object(regions, depth, bias, parameters));
    let hollow = hollow::depth_below_rims(depth, object, &rims, hollow::EIGHT_DIRECTIONS);
    let least = 1e-3 * parameters.least_hollow_mm;
    let not_convex = Grid::from_fn(read.width(), read.height(), |x, y| {
        read[(x, y)] && hollow[(x, y)] > least
    });
    let groups = wide_groups(&not_convex, doubt.least_pixels);
    let shown = beyond_the_hulls_error(&groups, &excess, regions, doubt);
    let mut labels = numbered(&wide_groups(&shown, doubt.least_pixels), &shown);
    fill_enclosed(&mut labels, &deeper(DepthKind::Filled));
    append(regions, &labels);
}

/// For each pixel of no region, how much deeper its depth lies behind the hull than noise, slope, registration and
/// `bias` explain, in metres; not a number where nothing can be said. Along the hull's outline, readings of what lies
/// behind the object are the mixed pixels of its contour.
fn excess(
    regions: &Regions,
    depth: &EnhancedDepth,
    bias: f64,
    parameters: &Parameters,
) -> Grid<f32> {
    let front = &regions.front;
    let least = 1e-3 * parameters.least_difference_mm;
    let (known, bias) = (regions.bias.metres as f32, bias as f32);
    Grid::from_fn_parallel(depth.depth.width(), depth.depth.height(), |x, y| {
        let hull = front.depth[(x, y)];
        if depth.kind[(x, y)] == DepthKind::None || !hull.is_finite() || regions.contains(x, y) {
            return f32::NAN;
        }
        let read = depth.depth[(x, y)] - known;
        let shift = front.slope(x, y) * parameters.registration_px;
        let noise = parameters.significance * depth.sigma[(x, y)].hypot(shift);
        let off = noise.max(least) + bias;
        if read + off > front.exit[(x, y)] && front.is_near_outline(x, y) {
            return f32::NAN;
        }
        read - hull - off
    })
}

/// The groups of connected pixels that are wide: so many of their pixels are no nearer to the group's outline than that
/// may be ragged.
fn wide_groups(mask: &Grid<bool>, least_pixels: usize) -> Vec<Vec<(usize, usize)>> {
    let inner = shrunk(mask);
    let mut seen = Grid::filled(mask.width(), mask.height(), false);
    let mut groups = Vec::new();
    for y in 0..mask.height() {
        for x in 0..mask.width() {
            if seen[(x, y)] || !mask[(x, y)] {
                continue;
            }
            let group = connected(mask, &mut seen, (x, y));
            if group.iter().filter(|&&pixel| inner[pixel]).count() >= least_pixels.max(1) {
                groups.push(group);
            }
        }
    }
    groups
}

/// A mask without the pixels that lie within [`RAGGED_PX`] of others.
fn shrunk(mask: &Grid<bool>) -> Grid<bool> {
    let mut left = mask.map(|&inside| if inside { 255 } else { 0 });
    for _ in 0..RAGGED_PX {
        left = erode(&left);
    }
    left.map(|&value| value != 0)
}

/// The pixels of groups that pass the hull deeper than it may itself be off there. Its error is stated as a mean over
/// neighbours, so that of a pixel counts no less than the mean of its group.
fn beyond_the_hulls_error(
    groups: &[Vec<(usize, usize)>],
    excess: &Grid<f32>,
    regions: &Regions,
    doubt: &Doubt,
) -> Grid<bool> {
    let place = |&(x, y): &(usize, usize)| {
        let pixel = Point2::new(x as f64, y as f64);
        (pixel, f64::from(regions.front.depth[(x, y)]))
    };
    let mut beyond = Grid::filled(excess.width(), excess.height(), false);
    for group in groups {
        let places: Vec<_> = group.iter().map(place).collect();
        let errors = (doubt.hull_errors)(&places);
        let mean = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        for (&pixel, &error) in group.iter().zip(&errors) {
            beyond[pixel] = f64::from(excess[pixel]) > error.max(mean);
        }
    }
    beyond
}

/// The pixels of each group with its number, from 1 on; of the size of `mask`.
fn numbered(groups: &[Vec<(usize, usize)>], mask: &Grid<bool>) -> Grid<u16> {
    let mut labels = Grid::filled(mask.width(), mask.height(), 0);
    for (number, group) in (1..u16::MAX).zip(groups) {
        for &pixel in group {
            labels[pixel] = number;
        }
    }
    labels
}

/// Appends regions to those that there are, where these have no pixel.
fn append(regions: &mut Regions, labels: &Grid<u16>) {
    let before = regions.count;
    for y in 0..labels.height() {
        for x in 0..labels.width() {
            let label = usize::from(labels[(x, y)]);
            let Ok(own) = u16::try_from(before + label) else {
                continue;
            };
            if label != 0 && !regions.contains(x, y) {
                regions.labels[(x, y)] = own;
                regions.count = regions.count.max(usize::from(own));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::region::HullRenderings;
    use crate::reconstruct::testing::evidence;

    const WIDTH: usize = 80;
    const HEIGHT: usize = 60;
    /// Depth of the hull's front, and where a ray leaves the hull, in metres.
    const FRONT: f32 = 0.7;
    const EXIT: f32 = 0.95;
    /// Depth of the table behind it.
    const TABLE: f32 = 1.0;

    /// A hull of which every part is seen too edge-on for equation 4, and what was read of each pixel.
    fn seen(
        claims: impl Fn(usize, usize) -> bool,
        read: impl Fn(usize, usize) -> f32,
    ) -> (Regions, EnhancedDepth) {
        let hull = |depth: f32| {
            Grid::from_fn(WIDTH, HEIGHT, |x, y| {
                if claims(x, y) { depth } else { f32::INFINITY }
            })
        };
        let (mut depth, mut regions) = evidence(TABLE, Grid::filled(WIDTH, HEIGHT, 0));
        depth.depth = Grid::from_fn(WIDTH, HEIGHT, read);
        regions.front = HullRenderings {
            depth: hull(FRONT),
            exit: hull(EXIT),
            is_front: Grid::filled(WIDTH, HEIGHT, false),
        };
        (regions, depth)
    }

    /// Adds the free space, if the hull may be off by `error` metres everywhere, and the depth by `bias`.
    fn add(regions: &mut Regions, depth: &EnhancedDepth, bias: f64, error: f64) {
        let object = Mask::filled(WIDTH, HEIGHT, 255);
        let doubt = Doubt {
            bias,
            least_pixels: 6,
            hull_errors: &|places| vec![error; places.len()],
        };
        add_free_space(regions, depth, &object, &doubt, &Parameters::default());
    }

    fn is_claimed(x: usize, y: usize) -> bool {
        (5..75).contains(&x) && (10..50).contains(&y)
    }

    /// A tray from its side: a rim, and below it a foot that stands back by 40 mm, beside which one sees the table.
    fn tray() -> (Regions, EnhancedDepth) {
        seen(is_claimed, |x, y| {
            if is_claimed(x, y) && y < 20 {
                FRONT
            } else if is_claimed(x, y) && (30..50).contains(&x) {
                0.74
            } else {
                TABLE
            }
        })
    }

    /// Two treads that meet in a corner, `depth` metres behind the straight line between their edges.
    fn corner(depth: f32) -> (Regions, EnhancedDepth) {
        seen(is_claimed, move |x, y| {
            if is_claimed(x, y) {
                let from_corner = (y as f32 - 30.0).abs() / 20.0;
                FRONT + depth * (1.0 - from_corner)
            } else {
                TABLE
            }
        })
    }

    #[test]
    fn below_the_rim_of_a_tray_the_table_and_the_foot_show_that_there_is_nothing() {
        let (mut regions, depth) = tray();
        add(&mut regions, &depth, 10e-3, 5e-3);
        assert_eq!(regions.last_hollow, 0);
        assert!(regions.count >= 1);
        for (x, y, what) in [(26, 28, "table"), (53, 28, "table"), (40, 30, "foot")] {
            assert!(regions.contains(x, y), "{what} at {x} {y}");
            assert!(!regions.is_hollow(x as isize, y as isize));
        }
        // The rim is where the hull is, and no reading of the object lies beyond the outermost parts of the table.
        for (x, y) in [(40, 14), (7, 46), (72, 46)] {
            assert!(!regions.contains(x, y), "{x} {y}");
        }
        let free_space = regions.free_space();
        assert_eq!(free_space.len(), regions.count);
        assert!(free_space.iter().sum::<usize>() > 100, "{free_space:?}");
    }

    #[test]
    fn between_an_arm_and_a_body_one_sees_through() {
        // The arm is 15 pixels wide, and joins the body above.
        let is_read = |x: usize, y: usize| is_claimed(x, y) && !((20..40).contains(&x) && y >= 20);
        let (mut regions, depth) =
            seen(is_claimed, |x, y| if is_read(x, y) { FRONT } else { TABLE });
        add(&mut regions, &depth, 10e-3, 5e-3);
        assert_eq!(regions.count, 1);
        assert!(regions.contains(30, 35));
        assert!(!regions.contains(12, 35) && !regions.contains(60, 35));
        // Where the hull may be off by as much as that, nothing is known.
        let (mut regions, depth) =
            seen(is_claimed, |x, y| if is_read(x, y) { FRONT } else { TABLE });
        add(&mut regions, &depth, 10e-3, 0.3);
        assert_eq!(regions.count, 0);
    }

    #[test]
    fn a_step_is_free_as_deep_as_the_hull_and_the_depth_may_not_be_off() {
        let (mut regions, depth) = corner(60e-3);
        add(&mut regions, &depth, 10e-3, 5e-3);
        assert_eq!(regions.count, 1);
        // 30 mm behind the hull half-way from the corner to an edge, 18 mm at seven tenths of the way.
        assert!(regions.contains(40, 30) && regions.contains(40, 20));
        assert!(!regions.contains(40, 13) && !regions.contains(40, 47));
        let (mut regions, depth) = corner(60e-3);
        add(&mut regions, &depth, 10e-3, 50e-3);
        assert_eq!(regions.count, 0);
    }

    #[test]
    fn below_the_bias_that_a_camera_may_have_nothing_is_free() {
        let (mut regions, depth) = corner(9.9e-3);
        add(&mut regions, &depth, 10e-3, 0.0);
        assert_eq!(regions.count, 0);
        let (mut regions, depth) = corner(9.9e-3);
        add(&mut regions, &depth, 1e-3, 0.0);
        assert_eq!(regions.count, 1);
        // What is known to remain counts if it is more.
        let (mut regions, depth) = corner(9.9e-3);
        regions.bias.remaining = 10e-3;
        add(&mut regions, &depth, 1e-3, 0.0);
        assert_eq!(regions.count, 0);
    }

    #[test]
    fn a_convex_body_keeps_all_of_a_loose_hull_whatever_the_bias() {
        let squared = |x: usize, y: usize| (x as f32 - 40.0).powi(2) + (y as f32 - 30.0).powi(2);
        for bias in [-8e-3, 0.0, 8e-3] {
            for ragged in [0, 1, 2] {
                // A dome 20 pixels in radius, whose outline is read up to two pixels too large, in a hull of 28.
                let read = |x: usize, y: usize| {
                    let radius = 20 + (7 * x + 13 * y) % (ragged + 1);
                    let is_body = squared(x, y) < (radius * radius) as f32;
                    bias + if is_body {
                        0.75 + 2e-4 * squared(x, y)
                    } else {
                        TABLE
                    }
                };
                let (mut regions, depth) = seen(|x, y| squared(x, y) < 784.0, read);
                let before = regions.labels.clone();
                add(&mut regions, &depth, 0.0, 0.0);
                assert_eq!(regions.count, 0, "{bias} m, {ragged} px");
                assert_eq!(regions.labels, before);
            }
        }
    }

    #[test]
    fn pixels_of_a_hollow_stay_its_own_and_thin_groups_are_no_evidence() {
        let (mut regions, depth) = corner(60e-3);
        regions.labels = Grid::from_fn(WIDTH, HEIGHT, |x, _| u16::from(x < 40));
        (regions.count, regions.last_hollow) = (1, 1);
        add(&mut regions, &depth, 10e-3, 5e-3);
        assert_eq!(regions.count, 2);
        assert_eq!((regions.labels[(30, 30)], regions.labels[(50, 30)]), (1, 2));
        assert!(regions.is_hollow(30, 30) && !regions.is_hollow(50, 30));
        // A slit of four pixels could be where an outline is ragged.
        let slit = |x: usize, _: usize| if (38..42).contains(&x) { TABLE } else { FRONT };
        let (mut regions, depth) = seen(is_claimed, slit);
        add(&mut regions, &depth, 10e-3, 5e-3);
        assert_eq!(regions.count, 0);
    }

    #[test]
    fn what_free_space_encloses_without_a_reading_is_free_if_it_was_filled_as_deep() {
        let (mut regions, mut depth) = corner(60e-3);
        depth.kind[(40, 30)] = DepthKind::Filled;
        add(&mut regions, &depth, 10e-3, 5e-3);
        assert!(regions.contains(40, 30));
        let (mut regions, mut depth) = corner(60e-3);
        depth.kind[(40, 30)] = DepthKind::Filled;
        depth.depth[(40, 30)] = FRONT;
        add(&mut regions, &depth, 10e-3, 5e-3);
        assert!(!regions.contains(40, 30) && regions.contains(44, 30));
    }
}
