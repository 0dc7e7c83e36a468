//! The objects of the simulated rig: closed, oriented, manifold meshes with z up that stand on the table at z = 0.
//! Surfaces of revolution are made from their profiles, the others from signed distances. Other files decide how an
//! object looks and how it is seen.

mod blocks;
mod bodies;
mod implicit;
mod prism;
mod profiles;
mod revolve;

use nalgebra::{Point3, Vector3};
use profiles::Profile;
use scand_core::mesh::{Mesh, components, extract};
use serde::{Deserialize, Serialize};

/// An object whose form is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, clap::ValueEnum, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shape {
    /// A tapered cup of 95 mm with a wall of 2.5 mm: deep, with steep walls.
    Cup,
    /// An open bowl, 160 mm across, with a wall of 4.5 mm.
    Bowl,
    /// A bowl of 196 mm in which three spheres rest, as one closed surface.
    FruitBowl,
    /// A vase with a neck narrower than its belly, most of whose inside no camera sees.
    Vase,
    /// A goblet: a small bowl on a thin stem.
    Goblet,
    /// A flat plate with a raised border.
    Plate,
    /// A mug with a handle, whose hole is seen through (genus 1).
    Mug,
    /// A ring that lies on the table (genus 1).
    Torus,
    /// An egg that stands on its blunt end: convex.
    Egg,
    /// A box of 80 x 55 x 40 mm, turned by 20 degrees: convex, with edges.
    Box,
    /// A ball of 30 mm radius: convex.
    Ball,
    /// A shallow pit with a broad, flat top and four notches.
    Ashtray,
    /// A block with two pits of different forms: two concave regions.
    TwoPits,
    /// A body of five leaning sides, each at an angle of its own: convex, with edges.
    Prism,
    /// A column with ribs 0.8 mm high, 3 mm apart: rings below, which stand in profile, and upright ones above, which
    /// do not.
    Relief,
    /// A round tray of 170 mm on a stem with a broad foot, beyond both of which it stands out: cameras that look down
    /// see little but the tray, and low ones see the table below it.
    Tray,
    /// Three steps of 22 mm, each 30 mm deep, with a concave corner at the back of each tread.
    Steps,
}

impl Shape {
    /// All of them.
    pub const ALL: [Self; 17] = [
        Self::Cup,
        Self::Bowl,
        Self::FruitBowl,
        Self::Vase,
        Self::Goblet,
        Self::Plate,
        Self::Mug,
        Self::Torus,
        Self::Egg,
        Self::Box,
        Self::Ball,
        Self::Ashtray,
        Self::TwoPits,
        Self::Prism,
        Self::Relief,
        Self::Tray,
        Self::Steps,
    ];

    /// The object's surface, in metres, of triangles with edges of about `spacing` metres.
    pub fn mesh(self, spacing: f64) -> Mesh {
        let spacing = spacing.max(1e-4);
        match self.form() {
            Form::Turned(profile) => revolve::revolve(&profile, spacing),
            Form::Edged(mesh) => mesh(spacing),
            Form::Solid(body) => meshed(&body, spacing),
        }
    }

    /// The surface of a mug whose handle is this many metres higher than [`Self::Mug`]'s.
    pub(super) fn mug_with_raised_handle(raised: f64, spacing: f64) -> Mesh {
        meshed(&bodies::mug(raised), spacing.max(1e-4))
    }

    /// The surface without what lies in a ball (centre, radius), all of it meshed from distances. Meshes of one shape
    /// with and without differ at the ball alone.
    pub(super) fn without(self, ball: Option<(Point3<f64>, f64)>, spacing: f64) -> Mesh {
        let whole = self.body();
        let bounds = whole.bounds;
        let distance = move |p: Point3<f64>| {
            let left = ball.map_or(f64::NEG_INFINITY, |(center, radius)| {
                radius - (p - center).norm()
            });
            whole.distance(p).max(left)
        };
        meshed(
            &bodies::Body::new(distance, bounds),
            spacing.clamp(1e-4, FINE),
        )
    }

    /// The object by its signed distance.
    fn body(self) -> bodies::Body {
        match self.form() {
            Form::Turned(profile) => bodies::revolution(&profile),
            Form::Edged(mesh) => convex(&mesh(0.01)),
            Form::Solid(body) => body,
        }
    }

    fn form(self) -> Form {
        use Form::{Edged, Solid, Turned};
        match self {
            Self::Cup => Turned(profiles::cup()),
            Self::Bowl => Turned(profiles::bowl()),
            Self::Vase => Turned(profiles::vase()),
            Self::Goblet => Turned(profiles::goblet()),
            Self::Plate => Turned(profiles::plate()),
            Self::Torus => Turned(profiles::torus()),
            Self::Egg => Turned(profiles::egg()),
            Self::Ball => Turned(profiles::ball()),
            Self::Tray => Turned(profiles::tray()),
            Self::Box => Edged(|spacing| blocks::turned_box([0.080, 0.055, 0.040], 20.0, spacing)),
            Self::Prism => Edged(prism::prism),
            Self::FruitBowl => Solid(bodies::fruit_bowl()),
            Self::Mug => Solid(bodies::mug(0.0)),
            Self::Ashtray => Solid(bodies::ashtray()),
            Self::TwoPits => Solid(bodies::two_pits()),
            Self::Relief => Solid(bodies::relief()),
            Self::Steps => Solid(bodies::steps()),
        }
    }

    /// Which part of the object a point of its surface belongs to: 0, or 1 and up for the fruit in a bowl.
    pub fn part(self, p: Point3<f64>) -> usize {
        match self {
            Self::FruitBowl => bodies::fruit_at(p).map_or(0, |k| k + 1),
            _ => 0,
        }
    }
}

/// What a shape is made from.
enum Form {
    /// Its outline turns around the z axis.
    Turned(Profile),
    /// It is convex and has sharp edges: its mesh, for triangles with edges of so many metres.
    Edged(fn(f64) -> Mesh),
    /// Its signed distance.
    Solid(bodies::Body),
}

/// Edge of the cells in which an implicit body is meshed, over that of the triangles that come of it.
const CELL: f64 = 1.5;

/// A body that breaks is meshed in triangles with edges no longer than this, in metres.
const FINE: f64 = 8e-4;

/// A convex body by the planes of its triangles.
fn convex(mesh: &Mesh) -> bodies::Body {
    let mut planes: Vec<(Vector3<f64>, f64)> = Vec::new();
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t).map(|v| v.cast::<f64>());
        let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-12) else {
            continue;
        };
        let offset = normal.dot(&a.coords);
        let is_new =
            |(n, d): &(Vector3<f64>, f64)| (n - normal).norm() > 1e-4 || (d - offset).abs() > 1e-6;
        if planes.iter().all(is_new) {
            planes.push((normal, offset));
        }
    }
    let corners = mesh.vertices.iter().map(|v| v.cast::<f64>());
    let (min, max) = corners.fold(
        (Point3::from([f64::MAX; 3]), Point3::from([f64::MIN; 3])),
        |(min, max), v| (min.inf(&v), max.sup(&v)),
    );
    let distance = move |p: Point3<f64>| {
        let beyond = planes
            .iter()
            .map(|(normal, offset)| normal.dot(&p.coords) - offset);
        beyond.fold(f64::NEG_INFINITY, f64::max)
    };
    bodies::Body::new(distance, [min.into(), max.into()])
}

/// A box of edges `size` (metres) that stands on the table at the origin, turned about z by `degrees`.
pub(super) fn block(size: [f64; 3], degrees: f64, spacing: f64) -> Mesh {
    blocks::turned_box(size, degrees, spacing)
}

/// Meshes a body and keeps its outer surface: what two parts that touch enclose between them is dropped.
fn meshed(body: &bodies::Body, spacing: f64) -> Mesh {
    let mut mesh = implicit::mesh(|p| body.distance(p), body.bounds, spacing * CELL);
    for v in &mut mesh.vertices {
        v.z = v.z.max(0.0);
    }
    let pieces = components(&mesh);
    match pieces.largest() {
        Some(largest) => extract(&mesh, &pieces, |piece| piece == largest).0,
        None => mesh,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scand_core::mesh::{check, volume_and_total_area};
    use std::f64::consts::PI;

    #[test]
    fn every_shape_is_one_closed_oriented_manifold_that_stands_on_the_table() {
        for shape in Shape::ALL {
            let mesh = shape.mesh(0.003);
            let report = check(&mesh);
            assert!(report.is_watertight(), "{shape:?}: {report:?}");
            let pieces = components(&mesh);
            assert_eq!(pieces.parts.len(), 1, "{shape:?}");
            let genus = i64::from(matches!(shape, Shape::Mug | Shape::Torus));
            // Around the fruit's contacts the gap is narrower than any cell and bridged here and there.
            if shape != Shape::FruitBowl {
                assert_eq!(pieces.parts[0].genus(), genus, "{shape:?}");
            }
            let lowest = mesh.vertices.iter().fold(1.0, |low: f32, v| low.min(v.z));
            assert!(lowest.abs() < 1e-4, "{shape:?} begins at {lowest}");
            assert!(
                volume_and_total_area(&mesh).0 > 0.0,
                "{shape:?} is inside out"
            );
        }
    }

    /// Asserts a mesh's volume to within a share of what is expected.
    fn assert_volume(mesh: &Mesh, shape: Shape, expected: f64, tolerance: f64) {
        let volume = volume_and_total_area(mesh).0;
        assert!(
            (volume / expected - 1.0).abs() < tolerance,
            "{shape:?}: {volume} for {expected}"
        );
    }

    #[test]
    fn volumes_are_those_of_the_closed_forms() {
        let cases = [
            (Shape::Ball, 4.0 / 3.0 * PI * 0.03_f64.powi(3)),
            (Shape::Torus, 2.0 * PI * PI * 0.045 * 0.016 * 0.016),
            (Shape::Box, 0.08 * 0.055 * 0.04),
            (Shape::Cup, profiles::cup().volume()),
            (Shape::Vase, profiles::vase().volume()),
            (Shape::Tray, profiles::tray().volume()),
        ];
        for (shape, expected) in cases {
            assert_volume(&shape.mesh(0.001), shape, expected, 0.003);
        }
    }

    #[test]
    fn the_volume_of_an_implicit_body_is_what_random_points_find() {
        let mut random = crate::random::Random::new(&[7]);
        for (shape, body) in [
            (Shape::FruitBowl, bodies::fruit_bowl()),
            (Shape::Mug, bodies::mug(0.0)),
            (Shape::Ashtray, bodies::ashtray()),
            (Shape::TwoPits, bodies::two_pits()),
            (Shape::Relief, bodies::relief()),
            (Shape::Steps, bodies::steps()),
        ] {
            let [min, max] = body.bounds.map(Point3::from);
            let points = 200_000;
            let inside = (0..points)
                .filter(|_| {
                    let at = |a: usize, u: f64| min[a] + (max[a] - min[a]) * u;
                    let u = [random.uniform(), random.uniform(), random.uniform()];
                    body.distance(Point3::new(at(0, u[0]), at(1, u[1]), at(2, u[2]))) < 0.0
                })
                .count();
            let box_volume: f64 = (max - min).iter().product();
            let expected = box_volume * inside as f64 / f64::from(points);
            assert_volume(&shape.mesh(0.002), shape, expected, 0.02);
        }
    }

    #[test]
    fn vertices_of_an_implicit_body_lie_on_its_surface() {
        let body = bodies::mug(0.0);
        let mesh = Shape::Mug.mesh(0.003);
        let far = |v: &&Point3<f32>| body.distance(v.cast()).abs() > 1.5e-4;
        assert!(mesh.vertices.iter().filter(far).count() * 100 < mesh.vertices.len());
    }

    /// Tests of more than ten seconds: `make check` leaves them to `make test`.
    mod long {
        use super::*;

        #[test]
        fn a_body_that_breaks_is_whole_but_for_the_ball() {
            for shape in Shape::ALL {
                let whole = shape.without(None, 0.002);
                let report = check(&whole);
                assert!(report.is_watertight(), "{shape:?}: {report:?}");
                let exact = volume_and_total_area(&shape.mesh(0.001)).0;
                assert_volume(&whole, shape, exact, 0.02);
            }
            let center = Point3::new(0.08, 0.0, 0.06);
            let whole = Shape::TwoPits.without(None, 0.002);
            let broken = Shape::TwoPits.without(Some((center, 0.012)), 0.002);
            assert!(check(&broken).is_watertight());
            let lost = volume_and_total_area(&whole).0 - volume_and_total_area(&broken).0;
            assert!(lost > 1e-8, "{lost}");
            let beyond = |mesh: &Mesh| {
                let vertices = mesh.vertices.iter().map(|v| v.cast::<f64>());
                let far: Vec<_> = vertices
                    .filter(|v| (v - center).norm() > 0.014)
                    .map(|v| v.z)
                    .collect();
                (far.len(), far.iter().sum::<f64>())
            };
            assert_eq!(beyond(&whole), beyond(&broken));
        }
    }
}
