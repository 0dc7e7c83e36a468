//! Refines a pose so that the viewing rays through each capture's contours do not miss the other capture's hull, by
//! Gauss–Newton with Huber's weights. A ray that goes deep through the hull adds nothing to the error, because a hull
//! may be larger than the object, but never smaller.

use super::body::{Body, Ray};
use super::motion::{Twist, moved};
use super::touch::{Target, Touch, touch};
use nalgebra::{Isometry3, Matrix6, Vector3};
use rayon::prelude::*;

/// Misses beyond this many pixels count no more than their length.
const HUBER_PX: f64 = 2.5;
/// Misses beyond this many pixels are not told apart.
const MOST_PX: f64 = 10.0;
/// Rays that touch with less room than this many pixels hold the pose.
const HOLDING_PX: f64 = 0.75;
/// Increases of the damping that a step is tried with.
const TRIALS: usize = 4;

/// A pose and how well the silhouettes bear it.
#[derive(Clone, Debug)]
pub(super) struct Aligned {
    /// Maps a point of the first body's rig into the second's.
    pub(super) pose: Isometry3<f64>,
    /// Root of the mean square by which the rays miss, in metres.
    pub(super) disagreement: f64,
    /// The normal matrix of the rays that hold the pose, a ray; turns are multiplied by [`lever`].
    pub(super) firmness: Matrix6<f64>,
}

/// Radius of a turn that counts as much as a translation.
pub(super) fn lever(a: &Body, b: &Body) -> f64 {
    0.7 * a.radius.min(b.radius)
}

/// Refines `pose`. `fixed` is a direction, with turns multiplied by [`lever`], along which it
/// does not move.
pub(super) fn align(
    a: &Body,
    b: &Body,
    pose: Isometry3<f64>,
    rays: Rays,
    fixed: Option<&Twist>,
) -> Aligned {
    let pair = Pair {
        a,
        b,
        stride: rays.stride,
    };
    let pixel = a.pixel.max(b.pixel);
    let mut pose = pose;
    let mut touches = pair.touches(&pose, None);
    for _ in 0..rays.rounds {
        let before = loss(&touches, pixel);
        pose = pair.descend(pose, touches, rays.steps, fixed);
        // Along some rays the best place is another one by now.
        touches = pair.touches(&pose, None);
        if loss(&touches, pixel) > 0.9 * before {
            break;
        }
    }
    Aligned {
        disagreement: disagreement(&touches, pixel),
        firmness: pair.firmness(&pose, &touches),
        pose,
    }
}

/// How much a refinement looks at.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rays {
    /// Every so many contour points there is a ray.
    pub(super) stride: usize,
    /// Steps of Gauss–Newton at most, in each round.
    pub(super) steps: usize,
    /// Rounds at most; in each the best places of all rays are looked for anew.
    pub(super) rounds: usize,
}

impl Rays {
    /// To tell poses apart.
    pub(super) const FEW: Self = Self {
        stride: 16,
        steps: 6,
        rounds: 2,
    };
    /// To put a pose back onto the silhouettes.
    pub(super) const SOME: Self = Self {
        stride: 10,
        steps: 4,
        rounds: 1,
    };
    /// To state a pose.
    pub(super) const MANY: Self = Self {
        stride: 4,
        steps: 8,
        rounds: 2,
    };
}

/// Two bodies and the rays that are compared.
struct Pair<'a> {
    a: &'a Body,
    b: &'a Body,
    stride: usize,
}

impl Pair<'_> {
    fn descend(
        &self,
        mut pose: Isometry3<f64>,
        mut touches: Vec<Touch>,
        steps: usize,
        fixed: Option<&Twist>,
    ) -> Isometry3<f64> {
        let (a, b) = (self.a, self.b);
        let scale = scale(a, b);
        let pixel = a.pixel.max(b.pixel);
        let mut loss = self::loss(&touches, pixel);
        let mut damping = 1e-2;
        for _ in 0..steps {
            let (mut normal, right) = self.equations(&pose, &touches);
            let size = (0..3).map(|i| normal[(i, i)]).sum::<f64>() / 3.0;
            if let Some(fixed) = fixed {
                normal += fixed * fixed.transpose() * (1e6 * size.max(1e-12));
            }
            let mut better = None;
            for _ in 0..TRIALS {
                let damped = normal + Matrix6::identity() * (damping * size.max(1e-12));
                let Some(cholesky) = damped.cholesky() else {
                    break;
                };
                let step = -cholesky.solve(&right).component_mul(&scale);
                let tried = moved(&pose, b.center, &step);
                let found = self.touches(&tried, Some(&touches));
                let tried_loss = self::loss(&found, pixel);
                if tried_loss < loss {
                    better = Some((tried, found, tried_loss));
                    break;
                }
                damping = damping * 6.0 + 1e-4;
            }
            let Some((tried, found, tried_loss)) = better else {
                break;
            };
            let is_done = loss - tried_loss < 1e-3 * loss;
            (pose, touches, loss) = (tried, found, tried_loss);
            damping /= 4.0;
            if is_done {
                break;
            }
        }
        pose
    }

    /// Each chosen ray of both against the other.
    fn touches(&self, pose: &Isometry3<f64>, near: Option<&[Touch]>) -> Vec<Touch> {
        let (a, b) = (self.a, self.b);
        let forth = [Target {
            body: b,
            body_from_ray: *pose,
            is_self: false,
        }];
        let back = [Target {
            body: a,
            body_from_ray: pose.inverse(),
            is_self: false,
        }];
        let of_a = a.chosen_rays(self.stride).map(|ray| (a, ray, &forth));
        let of_b = b.chosen_rays(self.stride).map(|ray| (b, ray, &back));
        let all: Vec<(&Body, &Ray, &[Target; 1])> = of_a.chain(of_b).collect();
        let each = all.par_iter().enumerate();
        let at = |i: usize| near.map(|n| n[i].along);
        each.map(|(i, (own, ray, targets))| touch(own, ray, *targets, at(i)))
            .collect()
    }

    fn equations(&self, pose: &Isometry3<f64>, touches: &[Touch]) -> (Matrix6<f64>, Twist) {
        let huber = HUBER_PX * self.a.pixel.max(self.b.pixel);
        let mut normal = Matrix6::zeros();
        let mut right = Twist::zeros();
        for (row, touch) in self.rows(pose, touches) {
            if touch.inside < 0.0 {
                let weight = (huber / -touch.inside).min(1.0);
                normal.syger(weight, &row, &row, 1.0);
                right += row * (weight * touch.inside);
            }
        }
        normal.fill_upper_triangle_with_lower_triangle();
        (normal, right)
    }

    fn firmness(&self, pose: &Isometry3<f64>, touches: &[Touch]) -> Matrix6<f64> {
        let holding = HOLDING_PX * self.a.pixel.max(self.b.pixel);
        let mut normal = Matrix6::zeros();
        for (row, touch) in self.rows(pose, touches) {
            if touch.inside < holding {
                normal.syger(1.0, &row, &row, 1.0);
            }
        }
        normal.fill_upper_triangle_with_lower_triangle();
        normal / touches.len().max(1) as f64
    }

    /// For each touch how it changes with the pose, turns multiplied by [`lever`].
    fn rows<'t>(
        &'t self,
        pose: &Isometry3<f64>,
        touches: &'t [Touch],
    ) -> impl Iterator<Item = (Twist, &'t Touch)> {
        let (a, b) = (self.a, self.b);
        let scale = scale(a, b);
        let pose = *pose;
        let count_a = a.rays.len().div_ceil(self.stride);
        let rays = a.chosen_rays(self.stride).chain(b.chosen_rays(self.stride));
        rays.zip(touches).enumerate().map(move |(i, (ray, touch))| {
            let p = ray.eye + ray.direction * touch.along;
            let (g, arm) = if i < count_a {
                (touch.gradient, pose * p - b.center)
            } else {
                // The other's ray stays, and the first body moves: its gradient turns, and counts against.
                (-(pose.rotation * touch.gradient), p - b.center)
            };
            let turn: Vector3<f64> = arm.cross(&g);
            let row = Twist::new(g.x, g.y, g.z, turn.x, turn.y, turn.z);
            (row.component_mul(&scale), touch)
        })
    }
}

/// What turns a step of the equations into a twist.
fn scale(a: &Body, b: &Body) -> Twist {
    let per_turn = 1.0 / lever(a, b);
    Twist::new(1.0, 1.0, 1.0, per_turn, per_turn, per_turn)
}

fn loss(touches: &[Touch], pixel: f64) -> f64 {
    let huber = HUBER_PX * pixel;
    let of = |t: &Touch| {
        let miss = (-t.inside).max(0.0);
        if miss < huber {
            0.5 * miss * miss
        } else {
            huber * (miss - 0.5 * huber)
        }
    };
    touches.iter().map(of).sum()
}

/// Root of the mean square by which rays miss.
pub(super) fn disagreement(touches: &[Touch], pixel: f64) -> f64 {
    let of = |t: &Touch| (-t.inside).clamp(0.0, MOST_PX * pixel).powi(2);
    (touches.iter().map(of).sum::<f64>() / touches.len().max(1) as f64).sqrt()
}

impl Aligned {
    /// The directions in which the pose is held least, the least first, with turns multiplied by [`lever`], and how
    /// firmly it is held in them.
    pub(super) fn softest(&self) -> Vec<(Twist, f64)> {
        let eigen = self.firmness.symmetric_eigen();
        let mut order: Vec<usize> = (0..6).collect();
        order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
        let direction = |&i: &usize| {
            let twist: Twist = eigen.eigenvectors.column(i).into_owned();
            (twist, eigen.eigenvalues[i].max(0.0))
        };
        order.iter().map(direction).collect()
    }
}
