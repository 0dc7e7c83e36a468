//! Compares faired hulls with shapes that are known exactly.

use super::*;
use crate::calibration::{Camera, Distortion, Intrinsics};
use crate::frame::CameraId;
use crate::image::Grid;
use crate::mesh::{Mesh, check, components};
use crate::reconstruct::hull::{Cone, ExtractedSurface};
use nalgebra::{Isometry3, Point2, Point3, Vector2, Vector3};

/// A ring of cameras that look down on what stands on the table, 0.4 m away.
fn ring(count: usize, width: usize) -> Vec<Camera> {
    let height = width * 3 / 4;
    let camera = |i: usize| {
        let turn = std::f64::consts::TAU * i as f64 / count as f64;
        let up = 0.1 + 0.12 * (i % 3) as f64;
        let eye = Point3::new(0.4 * turn.cos(), 0.4 * turn.sin(), up);
        let middle = Point3::new(0.0, 0.0, 0.03);
        let look = Isometry3::face_towards(&eye, &middle, &-Vector3::z());
        let center = Vector2::new(width as f64 / 2.0 - 0.5, height as f64 / 2.0 - 0.5);
        let focal = Vector2::repeat(1.6 * width as f64);
        let lens = Intrinsics::new(width, height, focal, center, Distortion::default()).unwrap();
        Camera::new(CameraId::new(&format!("c{i:02}")).unwrap(), lens, look)
    };
    (0..count).map(camera).collect()
}

/// A silhouette from how many pixels inside it each pixel is.
fn silhouette(camera: &Camera, inside_px: impl Fn(Point2<f64>) -> f64) -> Grid<u8> {
    let lens = &camera.intrinsics;
    Grid::from_fn(lens.width, lens.height, |x, y| {
        let inside = inside_px(Point2::new(x as f64, y as f64));
        (127.5 + 80.0 * inside).round().clamp(0.0, 255.0) as u8
    })
}

const BALL: Point3<f64> = Point3::new(0.0, 0.0, 0.035);

fn ball(camera: &Camera, radius: f64) -> Grid<u8> {
    let towards = BALL - camera.center();
    let pixel = towards.norm() / camera.intrinsics.focal_px.x;
    silhouette(camera, |p| {
        let ray = camera.ray(p).unwrap();
        (radius - towards.cross(&ray).norm()) / pixel
    })
}

/// Half the edges of a box that stands on the table.
const BOX: [f64; 3] = [0.03, 0.02, 0.03];

fn corners() -> [Point3<f64>; 8] {
    std::array::from_fn(|i| {
        let side = |axis: usize| if i >> axis & 1 == 0 { -1.0 } else { 1.0 };
        let z = if i >> 2 == 0 { 0.0 } else { 2.0 * BOX[2] };
        Point3::new(side(0) * BOX[0], side(1) * BOX[1], z)
    })
}

/// The outline of a box is the convex hull of its corners' pictures.
fn cuboid(camera: &Camera) -> Grid<u8> {
    let points: Vec<Point2<f64>> = corners()
        .iter()
        .map(|&c| camera.project(c).unwrap().0)
        .collect();
    let mut lines: Vec<(Point2<f64>, Vector2<f64>)> = Vec::new();
    for a in &points {
        for b in &points {
            let along = b - a;
            let normal = Vector2::new(-along.y, along.x);
            if along.norm() > 1e-9 && points.iter().all(|p| normal.dot(&(p - a)) >= -1e-9) {
                lines.push((*a, normal.normalize()));
            }
        }
    }
    silhouette(camera, |p| {
        lines
            .iter()
            .map(|(a, n)| n.dot(&(p - a)))
            .fold(f64::INFINITY, f64::min)
    })
}

fn volume() -> Volume {
    Volume::new(
        Point3::new(-0.06, -0.06, 0.0),
        Point3::new(0.06, 0.06, 0.09),
    )
    .unwrap()
}

fn hull_of<'a>(cameras: &'a [Camera], levels: &'a [Grid<u8>]) -> Hull<'a> {
    let pairs = cameras.iter().zip(levels);
    let cones = pairs.map(|(c, l)| Cone::new(c, l)).collect();
    Hull::new(cones, volume(), 2)
}

fn parameters() -> hull::Parameters {
    hull::Parameters {
        resolution: 90.0,
        ..hull::Parameters::default()
    }
}

/// The plain hull's mesh, and the faired one's with its facts.
fn faired(
    cameras: &[Camera],
    levels: &[Grid<u8>],
) -> (Mesh, Result<(Facts, ExtractedSurface), Refusal>) {
    let (hull, parameters) = (hull_of(cameras, levels), parameters());
    let lattice = hull::lattice(&hull, &parameters).unwrap();
    let plain = hull::extract(&hull, &lattice, &parameters)
        .unwrap()
        .surface
        .mesh;
    let found = fair_hull(&hull, &lattice, &plain, &parameters).map(|faired| {
        let solid = hull::extract_solid(&faired.solid, &lattice, &parameters).unwrap();
        (faired.facts, solid)
    });
    (plain, found)
}

/// Mean and largest of the values above a height: cameras that look down do not see what is below.
fn above(mesh: &Mesh, height: f32, off: impl Fn(Point3<f64>) -> f64) -> (f64, f64) {
    let raised = mesh.vertices.iter().filter(|v| v.z > height);
    let values: Vec<f64> = raised.map(|v| off(v.cast()).abs()).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (mean, values.iter().copied().fold(0.0, f64::max))
}

#[test]
fn between_views_a_ball_is_round() {
    let (cameras, radius) = (ring(8, 600), 0.03);
    let levels: Vec<_> = cameras.iter().map(|c| ball(c, radius)).collect();
    let (plain, found) = faired(&cameras, &levels);
    let (facts, solid) = found.unwrap();
    let mesh = &solid.surface.mesh;
    assert!(check(mesh).is_watertight());
    assert_eq!(components(mesh).parts.len(), 1);
    let off = |p: Point3<f64>| (p - BALL).norm() - radius;
    let ((before, _), (mean, worst)) = (above(&plain, 0.02, off), above(mesh, 0.02, off));
    assert!(mean < 0.35 * before, "{mean} of {before}");
    assert!(worst < 1e-3, "{worst}");
    assert!(facts.contour_rms_px < 0.3 && facts.kept < 0.2, "{facts:?}");
}

#[test]
fn cameras_that_are_there_twice_make_no_edge() {
    let (cameras, radius) = (ring(8, 600), 0.03);
    let mean = |cameras: &[Camera]| {
        let levels: Vec<_> = cameras.iter().map(|c| ball(c, radius)).collect();
        let (_, solid) = faired(cameras, &levels).1.unwrap();
        let off = |p: Point3<f64>| (p - BALL).norm() - radius;
        above(&solid.surface.mesh, 0.02, off).0
    };
    let once = mean(&cameras);
    let twice = mean(&[cameras.clone(), cameras].concat());
    assert!(twice < 1.1 * once, "{twice}, {once}");
}

#[test]
fn between_views_a_box_is_flat_and_its_edges_stay() {
    let cameras = ring(11, 640);
    let levels: Vec<_> = cameras.iter().map(cuboid).collect();
    let (plain, found) = faired(&cameras, &levels);
    let (_, solid) = found.unwrap();
    let mesh = &solid.surface.mesh;
    assert!(check(mesh).is_watertight());
    let off = |p: Point3<f64>| {
        let from_middle = p - Point3::new(0.0, 0.0, BOX[2]);
        let beyond = |i: usize| from_middle[i].abs() - BOX[i];
        beyond(0).max(beyond(1)).max(beyond(2))
    };
    let ((before, _), (mean, _)) = (above(&plain, 2e-3, off), above(mesh, 2e-3, off));
    assert!(mean < 0.1 * before, "{mean} of {before}");
    // Each corner of the top is still there.
    for corner in &corners()[4..] {
        let nearest = mesh
            .vertices
            .iter()
            .map(|v| (v.cast::<f64>() - corner).norm());
        let nearest = nearest.fold(f64::INFINITY, f64::min);
        assert!(nearest < 1e-3, "{nearest}");
    }
}

#[test]
fn at_places_in_front_of_which_the_object_was_read_the_hull_stays_and_nowhere_else() {
    let cameras = ring(11, 640);
    let levels: Vec<_> = cameras.iter().map(cuboid).collect();
    let (hull, parameters) = (hull_of(&cameras, &levels), parameters());
    let lattice = hull::lattice(&hull, &parameters).unwrap();
    let extracted = hull::extract(&hull, &lattice, &parameters).unwrap();
    let plain = extracted.surface.mesh;
    let surface = |faired: &Faired| {
        let extracted = hull::extract_solid(&faired.solid, &lattice, &parameters);
        extracted.unwrap().surface.mesh
    };
    let faired = fair_hull(&hull, &lattice, &plain, &parameters).unwrap();
    let (smooth, facts) = (surface(&faired), faired.facts);
    assert_eq!(facts.held_by_depth_area, None);

    let faired = faired.held_at(&[]);
    assert!(surface(&faired) == smooth);
    let none = Facts {
        held_by_depth_area: Some(0.0),
        ..facts
    };
    assert_eq!(faired.facts, none);

    // Over the flat top, on which no outline lies but its edges, the plain hull is a roof.
    let held = faired.held_at(&[Point3::new(0.0, 0.0, 2.0 * BOX[2])]);
    let mesh = surface(&held);
    assert!(check(&mesh).is_watertight());
    let middle = |mesh: &Mesh| {
        let near = mesh.vertices.iter().filter(|v| v.x.hypot(v.y) < 2e-3);
        near.map(|v| f64::from(v.z)).fold(0.0, f64::max)
    };
    let [top, roof, found] = [&smooth, &plain, &mesh].map(middle);
    assert!(roof - top > 1e-3, "{top} {roof}");
    assert!(found - top > 0.6 * (roof - top), "{top} {found} {roof}");
    let widest = |mesh: &Mesh| {
        let low = mesh.vertices.iter().filter(|v| v.z < 0.03);
        let widths = low.map(|v| v.x.abs().max(v.y.abs()));
        widths.fold(0.0, f32::max)
    };
    assert!((widest(&mesh) - widest(&smooth)).abs() < 1e-6);
    // A few cells around the place.
    let area = held.facts.held_by_depth_area.unwrap();
    assert!((2e-5..1e-3).contains(&area), "{area}");
    assert!((held.facts.kept - facts.kept - area / facts.area).abs() < 1e-9);
    assert!(held.facts.moved_area < facts.moved_area);
}

#[test]
fn contours_that_contradict_each_other_leave_the_hull() {
    let (cameras, radius) = (ring(8, 600), 0.03);
    // Every other camera shows the ball two pixels larger, as no object is.
    let level = |(i, c): (usize, &Camera)| ball(c, radius + if i % 2 == 0 { 0.0 } else { 1.2e-3 });
    let levels: Vec<_> = cameras.iter().enumerate().map(level).collect();
    let (plain, found) = faired(&cameras, &levels);
    let off = |p: Point3<f64>| ((p - BALL).norm() - radius).min(0.0);
    let inside = found.map_or(0.0, |(_, solid)| above(&solid.surface.mesh, 0.02, off).0);
    assert!(inside < above(&plain, 0.02, off).0 + 0.2e-3, "{inside}");
}

/// A ball with a rod that stands on it, of so many metres in radius.
fn ball_with_rod(camera: &Camera, rod: f64) -> Grid<u8> {
    let [from, to] = [BALL.z, 0.08].map(|z| Point3::new(0.0031, 0.0017, z));
    let points = (0..=60).map(|i| from + (to - from) * (f64::from(i) / 60.0));
    let points: Vec<_> = points.map(|p| camera.project(p).unwrap()).collect();
    let pixel = (BALL - camera.center()).norm() / camera.intrinsics.focal_px.x;
    let ball = ball(camera, 0.02);
    let lens = &camera.intrinsics;
    let rod = silhouette(camera, |p| {
        let along = points.iter().map(|(q, _)| (p - q).norm());
        rod / pixel - along.fold(f64::INFINITY, f64::min)
    });
    Grid::from_fn(lens.width, lens.height, |x, y| {
        ball[(x, y)].max(rod[(x, y)])
    })
}

#[test]
fn a_part_that_is_thinner_than_the_cells_of_the_fairing_keeps_the_hull() {
    let cameras = ring(6, 640);
    let levels: Vec<_> = cameras.iter().map(|c| ball_with_rod(c, 0.0006)).collect();
    let hull = hull_of(&cameras, &levels);
    let parameters = hull::Parameters {
        resolution: 160.0,
        ..hull::Parameters::default()
    };
    let lattice = hull::lattice(&hull, &parameters).unwrap();
    let plain = hull::extract(&hull, &lattice, &parameters).unwrap();
    let mesh = plain.surface.mesh;
    let top = mesh.vertices.iter().map(|v| v.z).fold(0.0, f32::max);
    assert!(top > 0.078, "{top}");
    match fair_hull(&hull, &lattice, &mesh, &parameters) {
        Err(Refusal::ThinPart { distance }) => assert!(distance > 0.01, "{distance}"),
        other => panic!("{:?}", other.map(|faired| faired.facts)),
    }
}

#[test]
fn an_object_of_few_pixels_keeps_its_hull() {
    let cameras = ring(7, 320);
    let levels: Vec<_> = cameras.iter().map(|c| ball(c, 0.025)).collect();
    let refusal = faired(&cameras, &levels).1.map(|_| ());
    assert!(
        matches!(refusal, Err(Refusal::TooSmall { radius_px }) if radius_px < 50.0),
        "{refusal:?}"
    );
}

#[test]
fn the_same_bits_whatever_the_number_of_threads() {
    let cameras = ring(7, 700);
    let levels: Vec<_> = cameras.iter().map(|c| ball(c, 0.025)).collect();
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let (_, found) = pool.install(|| faired(&cameras, &levels));
        let (facts, solid) = found.unwrap();
        (facts, solid.surface.mesh)
    };
    let (one, three) = (with(1), with(3));
    assert_eq!(one.0, three.0);
    assert!(one.1 == three.1);
}

/// Where the vertices of a box's hull are that go onto flat sides where `bears` says so. Of the points of the box's
/// edges those are certain that are `certain`.
fn put_on_sides(
    certain: impl Fn(&Point3<f64>) -> bool,
    bears: &(dyn Fn(Point3<f64>) -> bool + Sync),
) -> Vec<Point3<f64>> {
    let cameras = ring(11, 640);
    let levels: Vec<_> = cameras.iter().map(cuboid).collect();
    let (plain, _) = faired(&cameras, &levels);
    let pairs = cameras.iter().zip(&levels);
    let cones: Vec<Cone> = pairs.map(|(c, l)| Cone::new(c, l)).collect();
    let contours: Vec<Contour> = cones.iter().map(Contour::of).collect();
    let ends = (0..8).flat_map(|a| [1, 2, 4].map(|bit| (a, a | bit)));
    let along = |(a, b): (usize, usize)| {
        let [a, b] = [corners()[a], corners()[b]];
        (0..=40).map(move |i| a + (b - a) * (f64::from(i) / 40.0))
    };
    let edges = ends.filter(|(a, b)| a != b).flat_map(along);
    let edges: Vec<Point3<f64>> = edges.filter(certain).collect();
    let object = Volume {
        min: corners()[0],
        max: corners()[7],
    };
    let sides = Sides::find(&edges, &contours, 0.4 / 1024.0, &object).unwrap();
    let mut shape = Shape::new(&plain, 0.0, 1e-4);
    shape.put_on(&sides, bears);
    let is_on_side = |v: &usize| matches!(shape.roles[*v], shape::Role::Side(_));
    let on_sides = (0..shape.len()).filter(is_on_side);
    on_sides.map(|v| shape.positions[v]).collect()
}

#[test]
fn a_side_takes_only_vertices_that_no_outline_excludes_there() {
    let taken = |bears: &(dyn Fn(Point3<f64>) -> bool + Sync)| put_on_sides(|_| true, bears).len();
    let (all, half) = (taken(&|_| true), taken(&|p| p.x > 0.0));
    assert!(
        all > 1000 && half > all / 4 && half < 3 * all / 4,
        "{half} of {all}"
    );
    assert_eq!(taken(&|_| false), 0);
}

#[test]
fn sides_meet_where_no_edge_is_certain() {
    let all = put_on_sides(|_| true, &|_| true).len();
    // Near the table no edge is certain, and one that stands on it only at its top.
    let top = 2.0 * BOX[2];
    let is_certain = |p: &Point3<f64>| {
        let is_of_first = (p.xy() - corners()[0].xy()).norm() < 1e-6;
        p.z > 0.3 * top && (!is_of_first || p.z == top)
    };
    let on_sides = put_on_sides(is_certain, &|_| true);
    assert!(
        20 * on_sides.len() > 19 * all,
        "{} of {all}",
        on_sides.len()
    );
    for p in on_sides {
        let off = [p.x.abs() - BOX[0], p.y.abs() - BOX[1], p.z - top];
        let off = off.into_iter().fold(f64::NEG_INFINITY, f64::max);
        assert!(off.abs() < 0.3e-3 || p.z < 1e-6, "{p}");
    }
}
