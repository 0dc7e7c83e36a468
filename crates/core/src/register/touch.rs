//! Computes whether a viewing ray through a contour point of one capture can touch the space that the cones and tables
//! of other captures leave to the object: how deep any point of the ray lies within all of them at most. The ray
//! touches the object, so it cannot miss that space. Beside its table a cone is a little wider, for there shadows take
//! something of the object away from outlines.

use super::body::{Body, Ray, doubt};
use nalgebra::{Isometry3, Point3, Vector3};

/// A body that a ray must touch, and where it is.
#[derive(Clone, Copy)]
pub(super) struct Target<'a> {
    /// The body.
    pub(super) body: &'a Body,
    /// Maps a point of the ray's rig into the body's.
    pub(super) body_from_ray: Isometry3<f64>,
    /// Whether the ray's own outline has no say: a capture against itself.
    pub(super) is_self: bool,
}

/// The best place of a ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch {
    /// How far it lies within everything, in metres; negative where the ray misses.
    pub(super) inside: f64,
    /// Metres along the ray.
    pub(super) along: f64,
    /// How that grows with the place in the first target's frame.
    pub(super) gradient: Vector3<f64>,
}

/// A bound on `inside` grows by no more than this many metres along a metre of the ray.
const STEEPEST: f64 = 1.25;
/// Shortest step along a ray, as a share of the body's radius.
const STEP: f64 = 1.0 / 150.0;
/// Places that are looked at closely.
const PEAKS: usize = 3;
/// Shortenings of a bracket around a peak, to less than a hundredth of its length.
const SHORTENINGS: usize = 10;

/// One condition on the points of a ray: within an outline's cone, or above a table.
#[derive(Clone, Copy)]
enum Condition {
    /// Target, outline, and the ray in the camera's frame.
    Cone {
        target: usize,
        outline: usize,
        from: Vector3<f64>,
        step: Vector3<f64>,
        /// Height above the target's table at the ray's origin, and what it gains a metre.
        height: f64,
        rise: f64,
    },
    /// Height above a table at the ray's origin, and what it gains a metre. The ray's own table is no target's.
    Table {
        target: Option<usize>,
        height: f64,
        rise: f64,
    },
}

/// A ray against targets.
struct Probe<'a> {
    targets: &'a [Target<'a>],
    conditions: Vec<Condition>,
    /// Which condition decided last.
    decided: usize,
}

/// The best place of a ray of `own`; where it is known to be near a place, that is the only one where it is looked for.
pub(super) fn touch(own: &Body, ray: &Ray, targets: &[Target], near: Option<f64>) -> Touch {
    Probe::new(own, ray, targets).best(ray, near)
}

/// The best place of a ray of `own`, if an outline of a target, given by both their numbers, had no say.
pub(super) fn touch_without(
    own: &Body,
    ray: &Ray,
    targets: &[Target],
    (target, outline): (usize, usize),
) -> Touch {
    let mut probe = Probe::new(own, ray, targets);
    // None has decided yet, and the first one, a table, stays.
    probe.conditions.retain(|condition| {
        !matches!(*condition, Condition::Cone { target: t, outline: o, .. } if (t, o) == (target, outline))
    });
    probe.best(ray, None)
}

impl<'a> Probe<'a> {
    fn new(own: &Body, ray: &Ray, targets: &'a [Target<'a>]) -> Self {
        let count = targets
            .iter()
            .map(|t| t.body.outlines.len() + 1)
            .sum::<usize>();
        let mut conditions = Vec::with_capacity(count + 1);
        conditions.push(Condition::Table {
            target: None,
            height: ray.eye.z - own.floor,
            rise: ray.direction.z,
        });
        for (target, t) in targets.iter().enumerate() {
            let eye = t.body_from_ray * ray.eye;
            let direction = t.body_from_ray.rotation * ray.direction;
            for (outline, o) in t.body.outlines.iter().enumerate() {
                if !(t.is_self && outline == ray.view) {
                    conditions.push(Condition::Cone {
                        target,
                        outline,
                        from: o.in_camera(eye),
                        step: o.direction_in_camera(direction),
                        height: eye.z - t.body.floor,
                        rise: direction.z,
                    });
                }
            }
            if !t.is_self {
                conditions.push(Condition::Table {
                    target: Some(target),
                    height: eye.z - t.body.floor,
                    rise: direction.z,
                });
            }
        }
        Self {
            targets,
            conditions,
            decided: 0,
        }
    }

    /// The best place of the ray, looked for near a place or everywhere.
    fn best(&mut self, ray: &Ray, near: Option<f64>) -> Touch {
        let targets = self.targets;
        let first = &targets[0];
        let center = first.body_from_ray.inverse() * first.body.center;
        let middle = (center - ray.eye).dot(&ray.direction);
        let reach = 1.15 * targets.iter().map(|t| t.body.radius).fold(0.0, f64::max);
        let step = STEP * reach;
        let (low, high) = (middle - reach, middle + reach);
        let (peaks, around) = match near {
            Some(near) => (vec![near], 1.5 * step),
            None => (self.peaks([low, high], step), step),
        };
        let refined = peaks
            .into_iter()
            .map(|at| self.climb(at - around, at + around));
        let worst = (f64::NEG_INFINITY, middle);
        let (inside, along) = refined.fold(
            worst,
            |best, found| if found.0 > best.0 { found } else { best },
        );
        Touch {
            inside,
            along,
            gradient: self.gradient(ray, along, 0.1 * first.body.pixel),
        }
    }

    #[inline]
    fn value_of(&self, condition: &Condition, along: f64) -> f64 {
        let value = self.value_below(f64::INFINITY, condition, along);
        value.unwrap_or(f64::INFINITY)
    }

    /// The value of a condition where it is below a limit.
    #[inline]
    fn value_below(&self, limit: f64, condition: &Condition, along: f64) -> Option<f64> {
        match *condition {
            Condition::Cone {
                target,
                outline,
                from,
                step,
                height,
                rise,
            } => {
                let outline = &self.targets[target].body.outlines[outline];
                let doubt = doubt(height + rise * along);
                outline.sum_below(limit, from + step * along, doubt)
            }
            Condition::Table { height, rise, .. } => {
                Some(height + rise * along).filter(|&value| value < limit)
            }
        }
    }

    /// The least value of all conditions, or the first one below `enough`, and then that condition is asked first next
    /// time. What the condition that decided last says here is a limit for all others, most of which do not come near
    /// it.
    fn value(&mut self, along: f64, enough: f64) -> f64 {
        let last = self.value_of(&self.conditions[self.decided], along);
        let mut least = last.max(enough);
        for i in 0..self.conditions.len() {
            if let Some(value) = self.value_below(least, &self.conditions[i], along) {
                least = value;
                self.decided = i;
                if value < enough {
                    self.conditions.swap(0, i);
                    self.decided = 0;
                    break;
                }
            }
        }
        least
    }

    /// Places near the highest values. A step is as long as the values seen allow it to be without missing a higher
    /// one.
    fn peaks(&mut self, [low, high]: [f64; 2], step: f64) -> Vec<f64> {
        let mut best = f64::NEG_INFINITY;
        for i in 1..16 {
            let at = low + (high - low) * f64::from(i) / 16.0;
            best = best.max(self.value(at, best - step));
        }
        let margin = STEEPEST * step;
        let mut found: Vec<(f64, f64)> = Vec::new();
        let mut at = low;
        while at < high {
            let value = self.value(at, best - 40.0 * step);
            best = best.max(value);
            if value > best - margin {
                found.push((value, at));
            }
            at += ((best - value) / STEEPEST).max(step);
        }
        found.retain(|&(value, _)| value > best - margin);
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut peaks: Vec<f64> = Vec::new();
        for (_, at) in found {
            if peaks.iter().all(|p| (p - at).abs() > 1.5 * step) {
                peaks.push(at);
            }
            if peaks.len() == PEAKS {
                break;
            }
        }
        if peaks.is_empty() {
            peaks.push(0.5 * (low + high));
        }
        peaks
    }

    /// The highest value in a bracket, by golden sections, and where it is.
    fn climb(&mut self, mut low: f64, mut high: f64) -> (f64, f64) {
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let (mut a, mut b) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
        let never = f64::NEG_INFINITY;
        let (mut at_a, mut at_b) = (self.value(a, never), self.value(b, never));
        for _ in 0..SHORTENINGS {
            if at_a >= at_b {
                (high, b, at_b) = (b, a, at_a);
                a = high - GOLDEN * (high - low);
                at_a = self.value(a, never);
            } else {
                (low, a, at_a) = (a, b, at_b);
                b = low + GOLDEN * (high - low);
                at_b = self.value(b, never);
            }
        }
        if at_a >= at_b { (at_a, a) } else { (at_b, b) }
    }

    /// The condition that decides at a place.
    fn deciding(&self, along: f64) -> Condition {
        let values = self.conditions.iter().map(|c| (self.value_of(c, along), c));
        let least = values.min_by(|a, b| a.0.total_cmp(&b.0));
        least.map_or(self.conditions[0], |(_, c)| *c)
    }

    /// How the highest value grows with the place in the first target's frame. Where two conditions meet, it is a mean
    /// of both, such that along the ray it does not grow.
    fn gradient(&self, ray: &Ray, along: f64, step: f64) -> Vector3<f64> {
        let (before, after) = (self.deciding(along - step), self.deciding(along + step));
        let slope = |c: &Condition| {
            (self.value_of(c, along + step) - self.value_of(c, along - step)) / (2.0 * step)
        };
        let (rising, falling) = (slope(&before), slope(&after));
        let share = if rising - falling > 1e-6 {
            (-falling / (rising - falling)).clamp(0.0, 1.0)
        } else {
            0.5
        };
        let p = self.targets[0].body_from_ray * (ray.eye + ray.direction * along);
        self.gradient_of(&before, p, step) * share
            + self.gradient_of(&after, p, step) * (1.0 - share)
    }

    fn gradient_of(&self, condition: &Condition, p: Point3<f64>, step: f64) -> Vector3<f64> {
        match *condition {
            Condition::Cone {
                target: 0, outline, ..
            } => {
                let body = self.targets[0].body;
                let outline = &body.outlines[outline];
                Vector3::from_fn(|axis, _| {
                    let mut shift = Vector3::zeros();
                    shift[axis] = step;
                    let at = |p: Point3<f64>| {
                        outline.value(outline.in_camera(p)) + doubt(p.z - body.floor)
                    };
                    (at(p + shift) - at(p - shift)) / (2.0 * step)
                })
            }
            Condition::Table {
                target: Some(0), ..
            } => Vector3::z(),
            _ => Vector3::zeros(),
        }
    }
}
