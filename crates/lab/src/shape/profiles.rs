//! Profiles of surfaces of revolution: polygons in the half plane of radius and height, in metres.

use std::f64::consts::{FRAC_PI_2, PI};

/// Chords of a profile's arcs are no longer than this.
const CHORD: f64 = 0.0006;

/// A profile: points (radius, height) in the order in which the solid lies to their left.
#[derive(Clone, Debug)]
pub(super) struct Profile {
    /// The points. The first and the last lie on the axis, unless the profile is a loop.
    pub points: Vec<[f64; 2]>,
    /// Whether the last point joins the first, off the axis.
    pub is_loop: bool,
}

impl Profile {
    fn open(points: Vec<[f64; 2]>) -> Self {
        Self {
            points,
            is_loop: false,
        }
    }

    /// The segments, for a profile that is a loop or closes along the axis.
    pub(super) fn segments(&self) -> impl Iterator<Item = [[f64; 2]; 2]> + '_ {
        let n = self.points.len();
        let count = if self.is_loop { n } else { n - 1 };
        (0..count).map(move |k| [self.points[k], self.points[(k + 1) % n]])
    }

    /// Volume of the solid of revolution (Pappus, a sum over the segments' frusta).
    #[cfg(test)]
    pub(super) fn volume(&self) -> f64 {
        let frustum = |[[r0, z0], [r1, z1]]: [[f64; 2]; 2]| {
            PI / 3.0 * (z1 - z0) * (r0 * r0 + r0 * r1 + r1 * r1)
        };
        self.segments().map(frustum).sum()
    }
}

/// Signed distance to the solid that a profile sweeps: its segments in runs with a box around each, so that
/// most are never looked at.
pub(super) struct SweptProfile {
    runs: Vec<Run>,
}

struct Run {
    segments: Vec<[[f64; 2]; 2]>,
    min: [f64; 2],
    max: [f64; 2],
}

impl SweptProfile {
    pub(super) fn new(profile: &Profile) -> Self {
        let segments: Vec<_> = profile.segments().collect();
        Self {
            runs: segments.chunks(12).map(Run::new).collect(),
        }
    }

    /// Signed distance of a point at `r` from the axis and height `z`, negative inside. A profile that meets
    /// the axis is closed along it.
    pub(super) fn distance(&self, r: f64, z: f64) -> f64 {
        let mut squared = f64::INFINITY;
        let mut inside = false;
        for run in &self.runs {
            let outside = |p: f64, a: usize| (run.min[a] - p).max(p - run.max[a]).max(0.0);
            let is_near = outside(r, 0).powi(2) + outside(z, 1).powi(2) < squared;
            let is_beside = run.min[1] <= z && z <= run.max[1] && r <= run.max[0];
            if !is_near && !is_beside {
                continue;
            }
            for [a, b] in &run.segments {
                let (ex, ez) = (b[0] - a[0], b[1] - a[1]);
                let (wx, wz) = (r - a[0], z - a[1]);
                let t = ((wx * ex + wz * ez) / (ex * ex + ez * ez)).clamp(0.0, 1.0);
                squared = squared.min((wx - ex * t).powi(2) + (wz - ez * t).powi(2));
                // A ray outwards from the axis crosses the profile: only segments count, the axis not.
                if (a[1] > z) != (b[1] > z) && r < a[0] + ex * (z - a[1]) / ez {
                    inside = !inside;
                }
            }
        }
        let distance = squared.sqrt();
        if inside { -distance } else { distance }
    }
}

impl Run {
    fn new(segments: &[[[f64; 2]; 2]]) -> Self {
        let ends = || segments.iter().flatten();
        Self {
            segments: segments.to_vec(),
            min: [0, 1].map(|a| ends().fold(f64::INFINITY, |m, p| m.min(p[a]))),
            max: [0, 1].map(|a| ends().fold(f64::NEG_INFINITY, |m, p| m.max(p[a]))),
        }
    }
}

/// Points of a circle's arc from angle `from` to `to` (radians, 0 towards larger radii), ends included.
fn arc(center: [f64; 2], radius: f64, from: f64, to: f64) -> Vec<[f64; 2]> {
    let steps = ((to - from).abs() * radius / CHORD).ceil().max(6.0);
    (0..=steps as usize)
        .map(|k| from + (to - from) * k as f64 / steps)
        .map(|a| [center[0] + radius * a.cos(), center[1] + radius * a.sin()])
        .collect()
}

/// A smooth curve through points (Catmull–Rom, ends doubled).
fn smooth(through: &[[f64; 2]]) -> Vec<[f64; 2]> {
    const STEPS: usize = 24;
    let at = |k: isize| through[k.clamp(0, through.len() as isize - 1) as usize];
    let mut curve = Vec::new();
    for k in 0..through.len() as isize - 1 {
        let [p0, p1, p2, p3] = [at(k - 1), at(k), at(k + 1), at(k + 2)];
        for step in 0..STEPS {
            let t = step as f64 / STEPS as f64;
            curve.push([0, 1].map(|i| {
                let (a, b) = (p1[i] * 2.0, p2[i] - p0[i]);
                let c = 2.0 * p0[i] - 5.0 * p1[i] + 4.0 * p2[i] - p3[i];
                let d = 3.0 * (p1[i] - p2[i]) + p3[i] - p0[i];
                0.5 * (a + t * (b + t * (c + t * d)))
            }));
        }
    }
    curve.push(at(through.len() as isize - 1));
    curve
}

/// A vessel: its outside from the foot to the rim, a wall of constant thickness with a rounded rim, and a
/// flat floor at height `floor`.
fn vessel(outside: &[[f64; 2]], wall: f64, floor: f64) -> Profile {
    let mut points = vec![[0.0, outside[0][1]]];
    points.extend_from_slice(outside);
    let inside: Vec<_> = offset(outside, wall);
    let (outer, inner) = (outside[outside.len() - 1], inside[inside.len() - 1]);
    let center = [(outer[0] + inner[0]) / 2.0, (outer[1] + inner[1]) / 2.0];
    let start = (outer[1] - center[1]).atan2(outer[0] - center[0]);
    let rim = arc(center, wall / 2.0, start, start + PI);
    points.extend_from_slice(&rim[1..rim.len() - 1]);
    let first = inside.iter().rposition(|p| p[1] <= floor || p[0] <= 0.0);
    let above = &inside[first.map_or(0, |k| k + 1)..];
    points.extend(above.iter().rev());
    if let Some(below) = first.map(|k| inside[k]) {
        let t = (floor - below[1]) / (above[0][1] - below[1]);
        points.push([below[0] + (above[0][0] - below[0]) * t.max(0.0), floor]);
    }
    points.push([0.0, floor]);
    Profile::open(points)
}

/// A curve moved to its left by `distance`.
fn offset(curve: &[[f64; 2]], distance: f64) -> Vec<[f64; 2]> {
    (0..curve.len())
        .map(|k| {
            let (a, b) = (
                curve[k.saturating_sub(1)],
                curve[(k + 1).min(curve.len() - 1)],
            );
            let (dr, dz) = (b[0] - a[0], b[1] - a[1]);
            let length = dr.hypot(dz);
            [
                curve[k][0] - dz / length * distance,
                curve[k][1] + dr / length * distance,
            ]
        })
        .collect()
}

/// The outside of a bowl whose foot has radius `foot` and whose rim lies at (`rim`, `height`): an arc of a
/// circle around a point of the axis, which is returned too (its height).
fn bowl_outside(foot: f64, rim: f64, height: f64) -> (Vec<[f64; 2]>, f64) {
    let z = (rim * rim + height * height - foot * foot) / (2.0 * height);
    let radius = foot.hypot(z);
    let angle = |r: f64, h: f64| (h - z).atan2(r);
    let points = arc([0.0, z], radius, angle(foot, 0.0), angle(rim, height));
    (points, z)
}

pub(super) fn cup() -> Profile {
    let outside: Vec<_> = (0..=40)
        .map(|k| f64::from(k) / 40.0)
        .map(|t| [0.029 + 0.010 * t, 0.094 * t])
        .collect();
    vessel(&outside, 0.0025, 0.006)
}

pub(super) fn bowl() -> Profile {
    vessel(&bowl_outside(0.030, 0.080, 0.060).0, 0.0045, 0.006)
}

pub(super) fn fruit_bowl() -> Profile {
    vessel(&bowl_outside(0.038, 0.098, 0.062).0, 0.005, 0.006)
}

pub(super) fn vase() -> Profile {
    let outside = [
        [0.028, 0.0],
        [0.042, 0.030],
        [0.045, 0.060],
        [0.032, 0.098],
        [0.023, 0.120],
        [0.031, 0.140],
    ];
    vessel(&smooth(&outside), 0.0035, 0.007)
}

pub(super) fn goblet() -> Profile {
    let foot = [[0.036, 0.0], [0.036, 0.003], [0.012, 0.010]];
    let bowl = [
        [0.006, 0.020],
        [0.006, 0.055],
        [0.020, 0.068],
        [0.036, 0.090],
        [0.038, 0.120],
    ];
    let mut outside = foot.to_vec();
    outside.extend(smooth(&bowl));
    vessel(&outside, 0.003, 0.069)
}

pub(super) fn plate() -> Profile {
    let outside = [[0.055, 0.0], [0.068, 0.003], [0.080, 0.010], [0.102, 0.016]];
    vessel(&smooth(&outside), 0.004, 0.0045)
}

/// A flat tray, 85 mm in radius, whose underside is 92 mm above the table.
pub(super) fn tray() -> Profile {
    let foot_and_stem = [
        [0.0, 0.0],
        [0.055, 0.0],
        [0.055, 0.005],
        [0.014, 0.012],
        [0.014, 0.092],
    ];
    let mut points = foot_and_stem.to_vec();
    points.extend(arc([0.081, 0.096], 0.004, -FRAC_PI_2, FRAC_PI_2));
    points.push([0.0, 0.100]);
    Profile::open(points)
}

pub(super) fn torus() -> Profile {
    let mut points = arc([0.045, 0.016], 0.016, -FRAC_PI_2, 1.5 * PI);
    points.pop();
    Profile {
        points,
        is_loop: true,
    }
}

pub(super) fn egg() -> Profile {
    let steps = 160;
    let points = (0..=steps).map(|k| {
        let angle = PI * f64::from(k) / f64::from(steps);
        let radius = 0.0215 * angle.sin() * (1.0 + 0.16 * angle.cos());
        [radius.max(0.0), 0.029 * (1.0 - angle.cos())]
    });
    on_axis(points.collect())
}

pub(super) fn ball() -> Profile {
    on_axis(arc([0.0, 0.030], 0.030, -FRAC_PI_2, FRAC_PI_2))
}

/// Puts the ends of a profile exactly on the axis.
fn on_axis(mut points: Vec<[f64; 2]>) -> Profile {
    let last = points.len() - 1;
    points[0][0] = 0.0;
    points[last][0] = 0.0;
    Profile::open(points)
}
