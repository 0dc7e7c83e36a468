//! Bodies that are not surfaces of revolution, given by signed distances.

use super::profiles::{self, SweptProfile};
use nalgebra::{Point3, Vector3};
use std::f64::consts::{PI, TAU};

/// A body: negative inside. The value is a distance or smaller than one, so that empty space can be skipped.
pub(super) struct Body {
    distance: Box<dyn Fn(Point3<f64>) -> f64 + Sync>,
    /// Smallest and largest corner of a box around it.
    pub bounds: [[f64; 3]; 2],
}

impl Body {
    pub(super) fn new(
        distance: impl Fn(Point3<f64>) -> f64 + Sync + 'static,
        bounds: [[f64; 3]; 2],
    ) -> Self {
        Self {
            distance: Box::new(distance),
            bounds,
        }
    }

    pub(super) fn distance(&self, p: Point3<f64>) -> f64 {
        (self.distance)(p)
    }
}

/// Where fruit touch they merge with a fillet of this width, so that a contact has a size that can be meshed.
const CONTACT: f64 = 0.004;

/// Centres and radii of the fruit. Each rests on the bowl's floor or wall and touches a neighbour, with an
/// overlap of some tenths of a millimetre, as soft fruit does.
const FRUIT: [([f64; 3], f64); 3] = [
    ([-0.0275, -0.0080, 0.0327], 0.027),
    ([0.0230, -0.0060, 0.0297], 0.024),
    ([-0.0070, 0.0355, 0.0287], 0.022),
];

/// The fruit on whose surface a point lies.
pub(super) fn fruit_at(p: Point3<f64>) -> Option<usize> {
    FRUIT
        .iter()
        .position(|&(center, radius)| ((p - Point3::from(center)).norm() - radius).abs() < 4e-4)
}

pub(super) fn fruit_bowl() -> Body {
    let bowl = SweptProfile::new(&profiles::fruit_bowl());
    Body {
        distance: Box::new(move |p| {
            let fruit = FRUIT
                .iter()
                .map(|&(center, radius)| (p - Point3::from(center)).norm() - radius);
            fruit.fold(revolved(&bowl, p), |a, b| smooth_union(a, b, CONTACT))
        }),
        bounds: [[-0.101, -0.101, 0.0], [0.101, 0.101, 0.066]],
    }
}

/// The solid that a profile sweeps.
pub(super) fn revolution(profile: &profiles::Profile) -> Body {
    let most = |a: usize| profile.points.iter().fold(0.0, |m: f64, p| m.max(p[a]));
    let (radius, height) = (most(0), most(1));
    let swept = SweptProfile::new(profile);
    Body::new(
        move |p| revolved(&swept, p),
        [[-radius, -radius, 0.0], [radius, radius, height]],
    )
}

/// A mug; its handle is `raised` by this many metres.
pub(super) fn mug(raised: f64) -> Body {
    const HEIGHT: f64 = 0.092;
    Body {
        distance: Box::new(move |p| {
            let outside = cylinder(p, Vector3::zeros(), 0.040, HEIGHT, 0.003);
            let inside = cylinder(p, Vector3::new(0.0, 0.0, 0.006), 0.036, HEIGHT, 0.005);
            smooth_union(outside, handle(p, raised), 0.003).max(-inside)
        }),
        bounds: [[-0.041, -0.041, 0.0], [0.076, 0.041, HEIGHT + 0.001]],
    }
}

/// An oval ring in the plane y = 0, thicker than it is wide.
fn handle(p: Point3<f64>, raised: f64) -> f64 {
    let (x, z) = ((p.x - 0.043) / 0.9, (p.z - 0.048 - raised) / 1.1);
    let across = (x.hypot(z) - 0.027).hypot(p.y * 0.75);
    (across - 0.005) * 0.75
}

pub(super) fn ashtray() -> Body {
    const HEIGHT: f64 = 0.034;
    Body {
        distance: Box::new(|p| {
            let outside = cylinder(p, Vector3::zeros(), 0.060, HEIGHT, 0.002);
            let pit = cylinder(p, Vector3::new(0.0, 0.0, 0.009), 0.046, HEIGHT, 0.012);
            let along = |u: f64, v: f64| if u.abs() > v.abs() { v } else { u };
            let notch = along(p.x, p.y).hypot(p.z - HEIGHT) - 0.006;
            outside.max(-pit).max(-notch)
        }),
        bounds: [[-0.061, -0.061, 0.0], [0.061, 0.061, HEIGHT + 0.001]],
    }
}

pub(super) fn two_pits() -> Body {
    let half = Vector3::new(0.075, 0.042, 0.0275);
    Body {
        distance: Box::new(move |p| {
            let block = rounded_box(p - Vector3::new(0.0, 0.0, half.z), half, 0.003);
            let deep = cylinder(p, Vector3::new(-0.036, 0.0, 0.012), 0.028, 0.08, 0.008);
            let round = (p - Point3::new(0.037, 0.0, 0.060)).norm() - 0.031;
            block.max(-deep).max(-round)
        }),
        bounds: [[-0.076, -0.043, 0.0], [0.076, 0.043, 0.056]],
    }
}

/// Three steps that go down towards larger x.
pub(super) fn steps() -> Body {
    const TREAD: f64 = 0.030;
    const RISER: f64 = 0.022;
    const HALF_WIDTH: f64 = 0.040;
    // A block of so many treads ends below the tread that is farthest out of them.
    let block = |p: Point3<f64>, treads: f64| {
        let half = Vector3::new(
            0.5 * treads * TREAD,
            HALF_WIDTH,
            0.5 * (4.0 - treads) * RISER,
        );
        let middle = Vector3::new(half.x - 1.5 * TREAD, 0.0, half.z);
        rounded_box(p - middle, half, 0.001)
    };
    Body::new(
        move |p| block(p, 1.0).min(block(p, 2.0)).min(block(p, 3.0)),
        [[-0.046, -0.041, 0.0], [0.046, 0.041, 0.067]],
    )
}

/// Height and distance of the relief's ribs.
const RIBS: [f64; 2] = [0.0008, 0.003];

pub(super) fn relief() -> Body {
    const RADIUS: f64 = 0.034;
    const HEIGHT: f64 = 0.090;
    let [rib, apart] = RIBS;
    // The ribs' steepest slope: by so much the value is more than the distance.
    let slope = 1f64.hypot(PI * rib / apart);
    Body {
        distance: Box::new(move |p| {
            (cylinder(p, Vector3::zeros(), RADIUS, HEIGHT, 0.002) - rib * ribs(p, RADIUS)) / slope
        }),
        bounds: [
            [-RADIUS - 0.002, -RADIUS - 0.002, 0.0],
            [RADIUS + 0.002, RADIUS + 0.002, HEIGHT + 0.001],
        ],
    }
}

/// How far a rib stands out at a point, from 0 to 1: whole ribs between 9 and 39 mm of height, rings, and between
/// 48 and 78 mm, upright ones.
fn ribs(p: Point3<f64>, radius: f64) -> f64 {
    let apart = RIBS[1];
    let wave = |phase: f64| 0.5 - 0.5 * (TAU * phase).cos();
    let around = p.y.atan2(p.x) / TAU * (TAU * radius / apart).round();
    let fade =
        |z: f64| ((z - 0.048) / apart).clamp(0.0, 1.0) * ((0.078 - z) / apart).clamp(0.0, 1.0);
    // Above the top and on it there are none, so that the value stays a distance there.
    let beside = ((p.x.hypot(p.y) - 0.8 * radius) / (0.1 * radius)).clamp(0.0, 1.0);
    if (0.009..0.039).contains(&p.z) {
        beside * wave((p.z - 0.009) / apart)
    } else {
        beside * fade(p.z) * wave(around)
    }
}

fn revolved(swept: &SweptProfile, p: Point3<f64>) -> f64 {
    swept.distance(p.x.hypot(p.y), p.z)
}

/// A cylinder that stands on `foot`, its edges rounded.
fn cylinder(p: Point3<f64>, foot: Vector3<f64>, radius: f64, height: f64, rounding: f64) -> f64 {
    let p = p - foot;
    let side = p.x.hypot(p.y) - radius + rounding;
    let end = (p.z - height / 2.0).abs() - height / 2.0 + rounding;
    rounded(&[side, end], rounding)
}

fn rounded_box(p: Point3<f64>, half: Vector3<f64>, rounding: f64) -> f64 {
    let outside = [0, 1, 2].map(|a| p[a].abs() - half[a] + rounding);
    rounded(&outside, rounding)
}

/// Distance to a body with right angles, given how far a point is beyond each of its faces, rounded.
fn rounded(beyond: &[f64], rounding: f64) -> f64 {
    let outside = beyond.iter().map(|b| b.max(0.0).powi(2)).sum::<f64>();
    let inside = beyond.iter().fold(f64::NEG_INFINITY, |m, &b| m.max(b));
    outside.sqrt() + inside.min(0.0) - rounding
}

/// A union with a fillet of about `width` (polynomial smooth minimum, Quilez).
fn smooth_union(a: f64, b: f64, width: f64) -> f64 {
    let h = (width - (a - b).abs()).max(0.0) / width;
    a.min(b) - h * h * width / 4.0
}
