//! Bodies of revolution, as thrown and turned vessels are: where the points at which a faired surface touches contours
//! lie on one profile all around an axis, they show how far the surface between them may be off. Nothing here is
//! assumed: what does not fit states nothing.

use crate::reconstruct::fairing::Touch;
use crate::statistics::upper_median;
use nalgebra::{Matrix3, Matrix4, Point3, Vector2, Vector3, Vector4};
use std::f64::consts::TAU;

/// Fewest touches that show an axis.
const LEAST_TOUCHES: usize = 100;
/// Rounds of the axis' estimate, each of which trusts those touches more that fit better.
const ROUNDS: usize = 15;
/// Largest tilt of the axis, as a tangent: bodies of revolution stand on the table.
const MOST_TILT: f64 = 0.18;
/// How far the normals of half of the touches may pass by the axis, as a share of their distance from it. A cup and a
/// bowl have 0.006, a box has 0.23, and an oval whose axes differ by 4 % has this.
const MOST_PASSED: f64 = 0.03;
/// The profile at a place follows from the touches nearer than this share of the body's size that face much as it does
/// (given as a cosine); so many at least.
const NEAR: f64 = 0.04;
const ALIKE: f64 = 0.8;
const LEAST_NEAR: usize = 12;
/// Rounds of the profile's estimate.
const PROFILE_ROUNDS: usize = 4;
/// Of so many sectors around the axis, so many have to hold touches that fit, and there has to be one in the place's
/// own sector or in one beside it.
const SECTORS: usize = 12;
const LEAST_SECTORS: usize = 7;
/// A touch shows the body if its camera looks across the profile, its view turned out of the plane through the axis by
/// at least so much (as a sine). What the hull fills below what stands out is round, too, but cameras look along it.
const ACROSS: f64 = 0.7;
/// Touches that fit have to lie on both sides of a place along the profile, so many at least on each: beyond its last
/// touch nothing shows how a profile goes on.
const LEAST_ON_A_SIDE: usize = 3;
/// A place between touches is expected to be off by so many times their scatter around the profile.
const OF_SCATTER: f64 = 1.25;

/// A body of revolution.
pub struct RoundBody {
    axis: Axis,
    touches: Vec<RoundTouch>,
    /// How far from each other touches of one profile may be, in metres.
    near: f64,
}

/// A nearly vertical line.
struct Axis {
    point: Point3<f64>,
    direction: Vector3<f64>,
}

/// A touch, turned into one plane through the axis: x is the distance from the axis, y that along it.
struct RoundTouch {
    place: Vector2<f64>,
    normal: Vector2<f64>,
    sector: usize,
}

impl RoundBody {
    /// The body of revolution that most touches lie on, if there is one.
    pub fn find(touches: &[Touch]) -> Option<Self> {
        if touches.len() < LEAST_TOUCHES {
            return None;
        }
        let axis = Axis::of(touches)?;
        let across = touches
            .iter()
            .filter(|touch| axis.turn_of_view(touch) > ACROSS);
        let around = across.map(|touch| axis.turned(touch.point, touch.normal));
        let touches: Vec<RoundTouch> = around.collect();
        if touches.len() < LEAST_TOUCHES {
            return None;
        }
        let (mut low, mut high) = (touches[0].place, touches[0].place);
        for touch in &touches {
            low = low.inf(&touch.place);
            high = high.sup(&touch.place);
        }
        let size = Vector2::new(2.0 * high.x, high.y - low.y).norm();
        Some(Self {
            axis,
            touches,
            near: NEAR * size,
        })
    }

    /// How far the surface is expected to be off at a point of it, in metres, given the outward normal there: its
    /// distance from the profile, and how far touches are scattered around that. `None` where they show no profile all
    /// around.
    pub fn expected(&self, p: Point3<f64>, normal: Vector3<f64>) -> Option<f64> {
        let at = self.axis.turned(p, normal);
        let near = self.near(&at);
        let profile = Profile::through(&near)?;
        let mut is_held = [false; SECTORS];
        for touch in profile.fitting {
            is_held[touch.sector] = true;
        }
        let beside = [SECTORS - 1, 0, 1].map(|step| is_held[(at.sector + step) % SECTORS]);
        let held = is_held.iter().filter(|&&is_held| is_held).count();
        let is_all_around = held >= LEAST_SECTORS && beside.contains(&true);
        is_all_around.then(|| profile.distance.hypot(OF_SCATTER * profile.scatter))
    }

    /// The touches from which the profile at a place follows.
    fn near(&self, at: &RoundTouch) -> Vec<NearTouch<'_>> {
        let along = Vector2::new(-at.normal.y, at.normal.x);
        let near = self.touches.iter().filter(|touch| {
            (touch.place - at.place).norm() < self.near && touch.normal.dot(&at.normal) > ALIKE
        });
        let near = near.map(|touch| {
            let way = (touch.place - at.place) / self.near;
            NearTouch {
                touch,
                along: way.dot(&along),
                outwards: self.near * way.dot(&at.normal),
                nearness: (-4.0 * way.norm_squared()).exp(),
            }
        });
        near.collect()
    }
}

/// A touch as seen from a place near it.
struct NearTouch<'a> {
    touch: &'a RoundTouch,
    /// How far along the profile it is, as a share of how far touches may be.
    along: f64,
    /// How far outwards it is, in metres.
    outwards: f64,
    /// Its weight for its nearness.
    nearness: f64,
}

/// The profile that the touches near a place show.
struct Profile<'a> {
    /// How far the place is from it, in metres.
    distance: f64,
    /// How far the touches are scattered around it: root mean square, in metres.
    scatter: f64,
    /// Those that fit it, on both sides of the place.
    fitting: Vec<&'a RoundTouch>,
}

impl<'a> Profile<'a> {
    /// The parabola that most of the touches lie on; `None` if they are too few or all on one side.
    fn through(near: &[NearTouch<'a>]) -> Option<Self> {
        if near.len() < LEAST_NEAR {
            return None;
        }
        let mut weights: Vec<f64> = near.iter().map(|near| near.nearness).collect();
        let mut distance = 0.0;
        let mut residuals = Vec::new();
        let mut usual = 0.0;
        for _ in 0..PROFILE_ROUNDS {
            let parabola = parabola(near, &weights)?;
            let lies = |near: &NearTouch| near.outwards - parabola.dot(&powers(near.along));
            residuals = near.iter().map(lies).collect();
            usual = usual_size(&residuals);
            let trusted = near.iter().zip(&residuals);
            let trusted = trusted.map(|(near, r)| near.nearness * trust(r / (2.5 * usual)));
            weights = trusted.collect();
            distance = parabola.x.abs();
        }
        let squares = weights
            .iter()
            .zip(&residuals)
            .map(|(weight, r)| weight * r * r);
        let scatter = (squares.sum::<f64>() / weights.iter().sum::<f64>()).sqrt();
        let fitting = near.iter().zip(&residuals);
        let fitting: Vec<&NearTouch> = fitting
            .filter(|(_, r)| r.abs() <= 3.0 * usual)
            .map(|(near, _)| near)
            .collect();
        let before = fitting.iter().filter(|near| near.along < 0.0).count();
        if before.min(fitting.len() - before) < LEAST_ON_A_SIDE {
            return None;
        }
        Some(Self {
            distance,
            scatter,
            fitting: fitting.iter().map(|near| near.touch).collect(),
        })
    }
}

impl Axis {
    /// The nearly vertical line that the normals at most touches meet, if there is one (the linear complex of a surface
    /// of revolution's normals: Pottmann and Wallner, *Computational Line Geometry*, 2001).
    fn of(touches: &[Touch]) -> Option<Self> {
        let count = touches.len() as f64;
        let sum: Vector3<f64> = touches.iter().map(|touch| touch.point.coords).sum();
        let middle = Point3::from(sum / count);
        let squares = touches.iter().map(|t| (t.point - middle).norm_squared());
        let size = (squares.sum::<f64>() / count).sqrt();
        if size <= 0.0 {
            return None;
        }
        // By how much a normal passes by the axis is `row · axis + offset`, of a body of unit size.
        let row = |touch: &Touch| {
            let (way, normal) = ((touch.point - middle) / size, touch.normal);
            let moment = way.cross(&normal);
            (
                Vector4::new(moment.x, moment.y, normal.x, normal.y),
                moment.z,
            )
        };
        let rows: Vec<(Vector4<f64>, f64)> = touches.iter().map(row).collect();
        let (found, passed) = most_met(&rows)?;
        let [tilt_x, tilt_y, moment_x, moment_y] = found.into();
        let tilt = tilt_x.hypot(tilt_y);
        if tilt.is_nan() || tilt > MOST_TILT {
            return None;
        }
        let axis = Self {
            point: middle + Vector3::new(-moment_y, moment_x, 0.0) * size,
            direction: Vector3::new(tilt_x, tilt_y, 1.0).normalize(),
        };
        let distance = |touch: &Touch| axis.turned(touch.point, touch.normal).place.x;
        let distances: Vec<f64> = touches.iter().map(distance).collect();
        (size * passed <= MOST_PASSED * usual_size(&distances)).then_some(axis)
    }

    /// How far the view of a touch is turned out of the plane through the axis, as a sine; 0 along the axis.
    fn turn_of_view(&self, touch: &Touch) -> f64 {
        let across_axis = |v: Vector3<f64>| v - self.direction * v.dot(&self.direction);
        let (away, view) = (
            across_axis(touch.point - self.point),
            across_axis(touch.view),
        );
        let lengths = away.norm() * view.norm();
        if lengths > 0.0 {
            away.cross(&view).norm() / lengths
        } else {
            0.0
        }
    }

    /// A point and a normal there, turned around the axis.
    fn turned(&self, p: Point3<f64>, normal: Vector3<f64>) -> RoundTouch {
        let way = p - self.point;
        let along = way.dot(&self.direction);
        let away = way - self.direction * along;
        let outwards = away.try_normalize(1e-9).unwrap_or_else(Vector3::x);
        let in_plane = Vector2::new(normal.dot(&outwards), normal.dot(&self.direction));
        let share = (away.y.atan2(away.x) / TAU).rem_euclid(1.0);
        RoundTouch {
            place: Vector2::new(away.norm(), along),
            normal: in_plane.try_normalize(1e-9).unwrap_or_else(Vector2::x),
            sector: (share * SECTORS as f64) as usize % SECTORS,
        }
    }
}

/// The axis for which `row · axis + offset` is smallest for most rows, and how large it usually is then.
fn most_met(rows: &[(Vector4<f64>, f64)]) -> Option<(Vector4<f64>, f64)> {
    let mut weights = vec![1.0; rows.len()];
    let (mut found, mut usual) = (Vector4::zeros(), 0.0);
    for _ in 0..ROUNDS {
        // A ball has an axis in every direction: the vertical one.
        let mut normal = Matrix4::identity() * (1e-6 * rows.len() as f64);
        let mut right = Vector4::zeros();
        for ((row, offset), weight) in rows.iter().zip(&weights) {
            normal += row * row.transpose() * *weight;
            right -= row * (*offset * *weight);
        }
        found = normal.cholesky()?.solve(&right);
        let passed = rows.iter().map(|(row, offset)| row.dot(&found) + offset);
        let passed: Vec<f64> = passed.collect();
        usual = usual_size(&passed);
        weights = passed.iter().map(|p| trust(p / (2.0 * usual))).collect();
    }
    Some((found, usual))
}

/// The parabola through weighted touches: its value, slope and bend at the place.
fn parabola(near: &[NearTouch], weights: &[f64]) -> Option<Vector3<f64>> {
    let (mut normal, mut right) = (Matrix3::identity() * 1e-9, Vector3::zeros());
    for (near, weight) in near.iter().zip(weights) {
        let row = powers(near.along);
        normal += row * row.transpose() * *weight;
        right += row * (near.outwards * weight);
    }
    Some(normal.cholesky()?.solve(&right))
}

fn powers(x: f64) -> Vector3<f64> {
    Vector3::new(1.0, x, x * x)
}

/// How much a residual counts, given in sizes beyond which it counts a quarter and less.
fn trust(residual: f64) -> f64 {
    (1.0 + residual * residual).powi(-2)
}

/// The median of sizes; a little more than nothing.
fn usual_size(values: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = values.iter().map(|value| value.abs()).collect();
    upper_median(&mut sizes).unwrap_or(0.0).max(1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    /// Touches along twelve profiles around a tilted axis, 60 mm high, `wide` times as wide one way as the other.
    fn touches(wide: f64, radius: impl Fn(f64) -> f64) -> Vec<Touch> {
        let places = (0..12).flat_map(|i| (0..40).map(move |k| (i, f64::from(k) * 1.5e-3)));
        let tilt = Rotation3::from_axis_angle(&Vector3::y_axis(), 0.05);
        let touch = |(i, height): (i32, f64)| {
            let angle = f64::from(i) * TAU / 12.0 + 20.0 * height;
            let point = |angle: f64, height: f64| {
                let (x, y) = (angle.cos() * radius(height), angle.sin() * radius(height));
                tilt * Point3::new(0.01 + x * wide, y, height)
            };
            let here = point(angle, height);
            let around = point(angle + 1e-4, height) - here;
            let up = point(angle, height + 1e-6) - here;
            Touch {
                point: here,
                normal: around.cross(&up).normalize(),
                view: around.normalize(),
            }
        };
        places.map(touch).collect()
    }

    fn vase(height: f64) -> f64 {
        0.03 + 0.01 * (50.0 * height).sin()
    }

    fn at(touches: &[Touch], outwards: f64) -> Option<f64> {
        let touch = &touches[12 * 20 + 7];
        RoundBody::find(touches)?.expected(touch.point + touch.normal * outwards, touch.normal)
    }

    #[test]
    fn a_vase_is_known_all_around_and_what_stands_off_its_profile_is_off() {
        let vase = touches(1.0, vase);
        let on = at(&vase, 0.0).unwrap();
        assert!(on < 0.06e-3, "{on}");
        let off = at(&vase, 0.5e-3).unwrap();
        assert!((off - 0.5e-3).abs() < 0.06e-3, "{off}");
    }

    #[test]
    fn an_oval_is_no_body_of_revolution_and_a_slight_one_states_by_how_much_it_differs() {
        assert!(at(&touches(1.2, vase), 0.0).is_none());
        let slight = at(&touches(1.02, vase), 0.0).unwrap();
        assert!((0.1e-3..0.6e-3).contains(&slight), "{slight}");
    }

    #[test]
    fn a_profile_is_shown_only_where_touches_are_all_around() {
        let all = touches(1.0, vase);
        let half: Vec<Touch> = all
            .iter()
            .filter(|touch| touch.point.y > 0.0 || touch.point.z < 0.02)
            .copied()
            .collect();
        let body = RoundBody::find(&half).unwrap();
        for touch in half {
            let is_known = body.expected(touch.point, touch.normal).is_some();
            match touch.point.z {
                0.005..0.012 => assert!(is_known, "{touch:?}"),
                0.03.. => assert!(!is_known, "{touch:?}"),
                _ => {}
            }
        }
    }

    #[test]
    fn beyond_the_last_touch_nothing_is_known() {
        let vase = touches(1.0, vase);
        let body = RoundBody::find(&vase).unwrap();
        let below = vase[0].point - 1e-3 * Vector3::z();
        assert!(body.expected(below, vase[0].normal).is_none());
    }

    #[test]
    fn what_cameras_look_along_is_not_known_however_round_it_is() {
        let mut filled = touches(1.0, vase);
        for touch in &mut filled {
            if touch.point.z < 0.04 {
                touch.view = touch.normal.cross(&touch.view);
            }
        }
        let body = RoundBody::find(&filled).unwrap();
        for touch in filled {
            let expected = body.expected(touch.point, touch.normal);
            match touch.point.z {
                ..0.03 => assert!(expected.is_none(), "{touch:?}"),
                0.045..0.053 => assert!(expected.is_some(), "{touch:?}"),
                _ => {}
            }
        }
    }

    #[test]
    fn a_handle_beside_a_body_does_not_change_it_and_states_nothing() {
        let mut mug = touches(1.0, vase);
        let handle = (0..60).map(|i| {
            let angle = f64::from(i) * TAU / 60.0;
            let normal = Vector3::new(angle.cos(), 0.0, angle.sin());
            Touch {
                point: Point3::new(0.06, 0.0, 0.03) + normal * 0.004,
                normal,
                view: Vector3::y(),
            }
        });
        let first = mug.len();
        mug.extend(handle);
        assert!(at(&mug, 0.0).unwrap() < 0.1e-3);
        let body = RoundBody::find(&mug).unwrap();
        assert!(
            mug[first..]
                .iter()
                .all(|t| body.expected(t.point, t.normal).is_none())
        );
    }

    #[test]
    fn few_touches_and_a_box_show_no_axis() {
        let vase = touches(1.0, vase);
        assert!(RoundBody::find(&vase[..LEAST_TOUCHES - 1]).is_none());
        let side = |i: usize| [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y()][i % 4];
        let flat = (0..400).map(|i| {
            let normal = side(i);
            let along = normal.cross(&Vector3::z()) * (f64::from(i as u32 / 4 % 10) * 8e-3 - 0.04);
            let up = Vector3::z() * (f64::from(i as u32 / 40) * 5e-3);
            Touch {
                point: Point3::from(normal * 0.04 + along + up),
                normal,
                view: normal.cross(&Vector3::z()),
            }
        });
        assert!(RoundBody::find(&flat.collect::<Vec<Touch>>()).is_none());
    }
}
