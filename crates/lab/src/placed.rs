//! What stands on the table in each capture: the object at its place, what broke off it or is there in its stead, and a
//! prop beside it; with its light, which is fixed to the rig.

use super::faults::{CaptureFault, Exchange, OtherObject};
use super::lay::{moved, rig_from_shape};
use super::light::Light;
use super::material::{Material, Paint};
use super::rest::RestingPoses;
use super::rig::Bounds;
use super::{Error, Options, Shape, invalid, prop};
use nalgebra::{Isometry3, Point3, Vector3};
use scand_core::mesh::{Bvh, Mesh};
use std::sync::OnceLock;

/// The object on the table in a capture, and a prop if there is one.
#[derive(Debug)]
pub(super) struct Placed {
    /// The surfaces in the rig's frame, the prop's last.
    pub mesh: Mesh,
    /// How many of the triangles are the object's.
    pub object_triangles: usize,
    object_vertices: usize,
    pub material: Material,
    /// Where the object as it was made is.
    pub rig_from_shape: Isometry3<f64>,
    light: OnceLock<Light>,
}

impl Placed {
    /// The box around the object, without a prop.
    pub(super) fn object_bounds(&self) -> Bounds {
        Bounds::of(&Mesh {
            vertices: self.mesh.vertices[..self.object_vertices].to_vec(),
            triangles: Vec::new(),
        })
    }

    /// Bakes the light, once. Baking works in parallel and may meet itself on one thread, so no thread waits
    /// for another: at worst two do the same work.
    pub(super) fn bake(&self, rays: usize) {
        if self.light.get().is_none() {
            let _ = self.light.set(Light::bake(&self.mesh, rays));
        }
    }

    /// The light, once it is baked.
    pub(super) fn light(&self) -> Option<&Light> {
        self.light.get()
    }
}

/// The undamaged object in its own frame. If it breaks later, it is meshed as the broken one is, so that the two differ
/// only at the break.
pub(super) fn object(options: &Options) -> Mesh {
    let spacing = options.spacing_mm * 1e-3;
    match is_broken(options) {
        true => options.shape.without(None, spacing),
        false => options.shape.mesh(spacing),
    }
}

/// What stands on the table: one for all captures without poses, else one for each.
///
/// # Errors
/// If a fault is of a capture that is not there, or the object cannot have it.
pub(super) fn placed(options: &Options, object: &Mesh) -> Result<Vec<Placed>, Error> {
    check(options)?;
    let count = match needs_its_own(options) {
        true => options.captures,
        false => 1,
    };
    let rests = (!options.poses.is_empty()).then(|| RestingPoses::new(object));
    (0..count)
        .map(|index| one(options, object, rests.as_ref(), index))
        .collect()
}

fn is_broken(options: &Options) -> bool {
    !options.faults.chip_mm.is_empty() || !options.faults.pit_mm.is_empty()
}

/// Whether captures show different objects.
fn needs_its_own(options: &Options) -> bool {
    let faults = &options.faults;
    let differ = !faults.prop_mm.is_empty() || !faults.exchanged.is_empty();
    !options.poses.is_empty() || differ || is_broken(options)
}

fn one(
    options: &Options,
    object: &Mesh,
    rests: Option<&RestingPoses>,
    index: usize,
) -> Result<Placed, Error> {
    let faults = &options.faults;
    let exchange = faults.exchanged.iter().find(|e| e.capture == index);
    let (shape, scale, there) = match exchange {
        Some(exchange) => exchanged(options, object, exchange),
        None => (
            options.shape,
            Vector3::repeat(1.0),
            changed(options, object, index),
        ),
    };
    // Another object rests in its own way, and so does one of another height.
    let its_own = exchange.is_some().then(|| RestingPoses::new(&there));
    let rig_from_shape = match (options.poses.get(index), its_own.as_ref().or(rests)) {
        (Some(pose), Some(rests)) => rig_from_shape(*pose, index, &there, rests, options.seed),
        _ => Isometry3::identity(),
    };
    let mut mesh = match rig_from_shape == Isometry3::identity() {
        true => there,
        false => moved(&there, &rig_from_shape),
    };
    let (object_triangles, object_vertices) = (mesh.triangles.len(), mesh.vertices.len());
    if let Some(width_mm) = CaptureFault::of(&faults.prop_mm, index) {
        let beside = prop::beside(&mesh, width_mm * 1e-3, options.seed, index);
        append(&mut mesh, &beside);
    }
    Ok(Placed {
        mesh,
        object_triangles,
        object_vertices,
        material: Material::new(shape, options.seed, Paint::of(options))
            .at(rig_from_shape.inverse(), scale),
        rig_from_shape,
        light: OnceLock::new(),
    })
}

/// The object as it is at capture `index`: with what broke off before.
fn changed(options: &Options, object: &Mesh, index: usize) -> Mesh {
    let chip = CaptureFault::up_to(&options.faults.chip_mm, index);
    let pit = CaptureFault::up_to(&options.faults.pit_mm, index);
    let ball = match (chip, pit) {
        (Some(mm), _) => Some((corner(object), mm * 1e-3)),
        (None, Some(mm)) => Some((middle(object), mm * 1e-3)),
        (None, None) => None,
    };
    match ball {
        Some(ball) => options.shape.without(Some(ball), options.spacing_mm * 1e-3),
        None => object.clone(),
    }
}

/// The point farthest up and out along x: on a rim, an edge or a corner.
fn corner(object: &Mesh) -> Point3<f64> {
    let along = |v: &Point3<f32>| f64::from(v.x) + f64::from(v.z);
    let vertices = object.vertices.iter();
    let farthest = vertices.max_by(|a, b| along(a).total_cmp(&along(b)));
    farthest.map_or_else(Point3::origin, |v| v.cast())
}

/// The surface's uppermost point above the origin, or in a hollow its floor.
fn middle(object: &Mesh) -> Point3<f64> {
    let from = Point3::new(1e-4, 2e-4, 1.0);
    let hit = Bvh::new(object).raycast(from, -Vector3::z(), 2.0);
    hit.map_or_else(|| corner(object), |hit| from - Vector3::z() * hit.t)
}

fn exchanged(options: &Options, object: &Mesh, exchange: &Exchange) -> (Shape, Vector3<f64>, Mesh) {
    let part = |percent: f64| 1.0 + percent / 100.0;
    let scaled = |scale: Vector3<f64>| {
        let mut mesh = object.clone();
        for v in &mut mesh.vertices {
            *v = Point3::from(v.coords.cast::<f64>().component_mul(&scale)).cast();
        }
        (options.shape, scale, mesh)
    };
    let spacing = options.spacing_mm * 1e-3;
    match exchange.with {
        OtherObject::Shape(shape) => (shape, Vector3::repeat(1.0), shape.mesh(spacing)),
        OtherObject::Bigger(percent) => scaled(Vector3::repeat(part(percent))),
        OtherObject::Taller(percent) => scaled(Vector3::new(1.0, 1.0, part(percent))),
        OtherObject::HandleUp(mm) => {
            let mesh = Shape::mug_with_raised_handle(mm * 1e-3, spacing);
            (Shape::Mug, Vector3::repeat(1.0), mesh)
        }
    }
}

fn append(mesh: &mut Mesh, other: &Mesh) {
    let first = mesh.vertices.len() as u32;
    mesh.vertices.extend(&other.vertices);
    let shifted = other.triangles.iter().map(|t| t.map(|v| v + first));
    mesh.triangles.extend(shifted);
}

fn check(options: &Options) -> Result<(), Error> {
    let faults = &options.faults;
    let later = [("chip", &faults.chip_mm), ("pit", &faults.pit_mm)];
    for (what, list) in later {
        for fault in list {
            check_capture(what, fault.capture, 1, options.captures)?;
            super::within_range(what, fault.amount, [0.5, 20.0], " mm")?;
        }
    }
    let any = [
        ("prop", &faults.prop_mm),
        ("lost piece", &faults.lost_piece_mm),
    ];
    for (what, list) in any {
        for fault in list {
            check_capture(what, fault.capture, 0, options.captures)?;
            super::within_range(what, fault.amount, [1.0, 60.0], " mm")?;
        }
    }
    for exchange in &faults.exchanged {
        check_capture("exchanged object", exchange.capture, 1, options.captures)?;
        if matches!(exchange.with, OtherObject::HandleUp(_)) && options.shape != Shape::Mug {
            let expected = "bigger, taller or a shape: only a mug has a handle to raise";
            return Err(invalid("exchanged object", exchange.with, expected));
        }
    }
    Ok(())
}

/// The first capture is the object itself, so what happens to the object happens later.
fn check_capture(
    what: &'static str,
    found: usize,
    first: usize,
    count: usize,
) -> Result<(), Error> {
    if found < first || found >= count {
        let expected = format!("a capture from {first} to {}, counted from 0", count - 1);
        return Err(invalid(what, format!("of capture {found}"), expected));
    }
    Ok(())
}
