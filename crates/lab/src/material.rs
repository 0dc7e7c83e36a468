//! The objects' materials: linear reflectance at each point. Nothing is as blue as the backdrop.

use super::noise::field;
use super::{Options, Shape};
use nalgebra::{Isometry3, Point3, Vector3};

/// What is painted on an object.
#[derive(Clone, Copy, Debug)]
pub(super) enum Paint {
    /// Nothing: each part has one colour.
    Plain,
    /// A pattern of patches and speckles.
    Patches,
    /// Rings about the axis of the shape as it was made.
    Rings,
}

impl Paint {
    pub(super) fn of(options: &Options) -> Self {
        match options {
            Options { rings: true, .. } => Self::Rings,
            Options { textured: true, .. } => Self::Patches,
            _ => Self::Plain,
        }
    }
}

/// The object's reflectance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Material {
    shape: Shape,
    seed: u64,
    paint: Paint,
    /// The pose of the shape as it was made, and the scale of the copy on the table.
    shape_from_rig: Isometry3<f64>,
    scale: Vector3<f64>,
}

impl Material {
    pub(super) fn new(shape: Shape, seed: u64, paint: Paint) -> Self {
        Self {
            shape,
            seed,
            paint,
            shape_from_rig: Isometry3::identity(),
            scale: Vector3::repeat(1.0),
        }
    }

    /// The same material on an object that lies elsewhere, and is larger along its own axes.
    pub(super) fn at(self, shape_from_rig: Isometry3<f64>, scale: Vector3<f64>) -> Self {
        Self {
            shape_from_rig,
            scale,
            ..self
        }
    }

    /// Linear reflectance (red, green, blue) at a point of the surface, in the rig's frame.
    pub(super) fn reflectance(&self, p: Point3<f64>) -> [f32; 3] {
        let p = Point3::from((self.shape_from_rig * p).coords.component_div(&self.scale));
        let part = self.shape.part(p);
        let base = self.base(part);
        let scaled = |metres: f64| [p.x / metres, p.y / metres, p.z / metres];
        let seed = self.seed.wrapping_add(part as u64 * 101);
        let (patch, speckle) = match self.paint {
            Paint::Plain => return base,
            Paint::Patches => (
                smoothstep(0.42, 0.58, field(seed, scaled(0.013))) as f32,
                0.85 + 0.3 * field(seed ^ 1, scaled(0.0018)) as f32,
            ),
            Paint::Rings => (ring(p.z), 1.0),
        };
        let second = [base[0] * 0.72, base[1] * 0.38, base[2] * 0.32];
        [0, 1, 2].map(|c| (base[c] * (1.0 - patch) + second[c] * patch) * speckle)
    }

    fn base(&self, part: usize) -> [f32; 3] {
        match (self.shape, part) {
            (Shape::FruitBowl, 0) => [0.62, 0.57, 0.47],
            (Shape::FruitBowl, 1) => [0.68, 0.28, 0.04],
            (Shape::FruitBowl, 2) => [0.30, 0.42, 0.06],
            (Shape::FruitBowl, _) => [0.48, 0.06, 0.04],
            (Shape::Cup | Shape::Goblet | Shape::Plate | Shape::Tray, _) => [0.72, 0.70, 0.66],
            (Shape::Bowl | Shape::Vase, _) => [0.58, 0.40, 0.26],
            (Shape::Mug, _) => [0.52, 0.10, 0.07],
            (Shape::Egg, _) => [0.66, 0.48, 0.34],
            (Shape::Torus | Shape::Ball, _) => [0.60, 0.34, 0.08],
            (Shape::Box | Shape::TwoPits | Shape::Prism | Shape::Steps, _) => [0.46, 0.33, 0.19],
            (Shape::Ashtray | Shape::Relief, _) => [0.38, 0.42, 0.34],
        }
    }
}

/// How much of the second colour a ring has at a height in metres. Two lengths of wave, so that rings tell upright from
/// upside-down.
fn ring(height: f64) -> f32 {
    (0.5 + 0.25 * ((520.0 * height).sin() + (330.0 * height).cos())) as f32
}

fn smoothstep(low: f64, high: f64, value: f64) -> f64 {
    let t = ((value - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
