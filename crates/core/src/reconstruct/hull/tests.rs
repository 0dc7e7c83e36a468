//! Compares hulls with shapes that are known exactly.

use super::*;
use crate::calibration::{Camera, Distortion, Intrinsics};
use crate::frame::CameraId;
use crate::image::Grid;
use crate::reconstruct::surface::{Side, UndecidedConstraints};
use nalgebra::{Isometry3, Point2, Vector2, Vector3};

fn camera(index: usize, eye: Point3<f64>, width: usize, height: usize) -> Camera {
    let look = Isometry3::face_towards(&eye, &Point3::origin(), &-Vector3::z());
    let focal = Vector2::repeat(1.2 * width as f64);
    let center = Vector2::new(width as f64 / 2.0 - 0.5, height as f64 / 2.0 - 0.5);
    let lens = Intrinsics::new(width, height, focal, center, Distortion::default()).unwrap();
    Camera::new(CameraId::new(&format!("c{index:02}")).unwrap(), lens, look)
}

fn ring(count: usize, width: usize, height: usize) -> Vec<Camera> {
    let eye = |i: usize| {
        let turn = std::f64::consts::TAU * i as f64 / count as f64;
        Point3::new(
            0.4 * turn.cos(),
            0.4 * turn.sin(),
            0.05 + 0.15 * (i % 3) as f64,
        )
    };
    (0..count)
        .map(|i| camera(i, eye(i), width, height))
        .collect()
}

/// The silhouette of a ball around the origin: signed distance in the picture, 80 values a pixel.
fn ball_silhouette(camera: &Camera, radius: f64) -> Grid<u8> {
    let lens = &camera.intrinsics;
    Grid::from_fn(lens.width, lens.height, |x, y| {
        let ray = camera.ray(Point2::new(x as f64, y as f64)).unwrap();
        let to_center = -camera.center().coords;
        let miss = to_center.cross(&ray).norm() - radius;
        let pixel = to_center.norm() / lens.focal_px.x;
        (127.5 - 80.0 * miss / pixel).round().clamp(0.0, 255.0) as u8
    })
}

fn cube(half: f64) -> Volume {
    Volume::new(Point3::from([-half; 3]), Point3::from([half; 3])).unwrap()
}

fn surface_of(
    cameras: &[Camera],
    levels: &[Grid<u8>],
    volume: Volume,
    parameters: &Parameters,
) -> ExtractedSurface {
    let cones = cameras
        .iter()
        .zip(levels)
        .map(|(c, l)| Cone::new(c, l))
        .collect();
    let hull = Hull::new(cones, volume, parameters.least_views);
    let lattice = lattice(&hull, parameters).unwrap();
    extract(&hull, &lattice, parameters).unwrap()
}

/// Beyond the pictures, and along their edges, no camera objects to space; none confirms it either.
#[test]
fn the_lattice_is_as_fine_in_a_volume_whose_corners_no_camera_sees() {
    let (radius, cameras) = (0.05, ring(7, 640, 480));
    let levels: Vec<_> = cameras.iter().map(|c| ball_silhouette(c, radius)).collect();
    let cell_size = |volume: Volume| {
        let cones = cameras.iter().zip(&levels).map(|(c, l)| Cone::new(c, l));
        let hull = Hull::new(cones.collect(), volume, Parameters::default().least_views);
        lattice(&hull, &Parameters::default()).unwrap().cell_size
    };
    let (close, roomy) = (cell_size(cube(0.08)), cell_size(cube(0.35)));
    assert!(roomy < 1.3 * close, "{close} m, {roomy} m");
}

/// A convex silhouette gives a cone that is known in closed form: the tangent cone of the ball. The hull is
/// their intersection, so the distance of a vertex to it is known exactly.
#[test]
fn the_hull_of_a_ball_is_the_intersection_of_its_tangent_cones() {
    let (radius, cameras) = (0.05, ring(7, 640, 480));
    let levels: Vec<_> = cameras.iter().map(|c| ball_silhouette(c, radius)).collect();
    let found = surface_of(&cameras, &levels, cube(0.08), &Parameters::default());
    assert!(mesh::check(&found.surface.mesh).is_watertight());
    assert_eq!(mesh::components(&found.surface.mesh).parts.len(), 1);
    // Signed distance to a tangent cone: its apex is the camera, its sine radius / distance.
    let beyond = |camera: &Camera, p: Point3<f64>| {
        let (axis, q) = (-camera.center().coords, p - camera.center());
        let along = q.dot(&axis.normalize());
        let across = (q - axis.normalize() * along).norm();
        let sine = radius / axis.norm();
        across * (1.0 - sine * sine).sqrt() - along * sine
    };
    let off: Vec<f64> = found
        .surface
        .mesh
        .vertices
        .iter()
        .map(|v| {
            cameras
                .iter()
                .map(|c| beyond(c, v.cast()))
                .fold(f64::MIN, f64::max)
        })
        .collect();
    let mean = off.iter().map(|d| d.abs()).sum::<f64>() / off.len() as f64;
    let worst = off.iter().map(|d| d.abs()).fold(0.0, f64::max);
    assert!(mean < 20e-6, "mean {mean}");
    assert!(worst < 300e-6, "worst {worst}");
}

/// A cell of a third of a pixel: the contour leaves many of them undecided, which are no speckles.
#[test]
fn pixels_much_coarser_than_cells_are_no_speckles() {
    let cameras = ring(6, 64, 48);
    let levels: Vec<_> = cameras.iter().map(|c| ball_silhouette(c, 0.05)).collect();
    let parameters = Parameters {
        smallest_cell_px: 0.3,
        ..Parameters::default()
    };
    let found = surface_of(&cameras, &levels, cube(0.08), &parameters);
    assert!(mesh::check(&found.surface.mesh).is_watertight());
}

/// Of more than 63 cameras, some share a bit of what is undecided.
#[test]
fn a_cube_of_space_is_never_called_inside_or_outside_wrongly() {
    for count in [5, 66] {
        let decided = decided_cubes(&ring(count, 320, 240), 0.2);
        assert!(decided > 2000, "{count} cameras: {decided}");
    }
}

/// Beside a picture, a distorted lens shows nothing, also where its model gives a pixel or folds over.
#[test]
fn a_cube_beside_the_pictures_of_distorted_lenses_is_never_called_inside_or_outside_wrongly() {
    for radial in [-0.15, 0.3] {
        let mut cameras = ring(5, 320, 240);
        for camera in &mut cameras {
            let Intrinsics {
                width,
                height,
                focal_px,
                center_px,
                ..
            } = camera.intrinsics;
            let distortion = Distortion {
                radial: [radial, 0.0, 0.0, 0.0, 0.0, 0.0],
                tangential: [1e-3, -1e-3],
            };
            camera.intrinsics =
                Intrinsics::new(width, height, 0.7 * focal_px, center_px, distortion).unwrap();
        }
        let decided = decided_cubes(&cameras, 0.6);
        assert!(decided > 3000, "{radial}: {decided}");
    }
}

/// How many cubes of 4000, up to so many metres beside a ball, are called inside or outside; each is held against
/// points in it. What is undecided of a cube must also be enough to tell the value of a point in it.
fn decided_cubes(cameras: &[Camera], beside: f64) -> usize {
    let levels: Vec<_> = cameras.iter().map(|c| ball_silhouette(c, 0.05)).collect();
    let cones = cameras
        .iter()
        .zip(&levels)
        .map(|(c, l)| Cone::new(c, l))
        .collect();
    let hull = Hull::new(cones, cube(1.5 * beside), 2);
    let mut random = 1u64;
    let mut uniform = || {
        random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (random >> 33) as f64 / f64::from(1u32 << 31)
    };
    let mut decided = 0;
    for _ in 0..4000 {
        let center =
            Point3::new(uniform() - 0.5, uniform() - 0.5, uniform() - 0.5) * (2.0 * beside);
        let half = 0.03 * uniform();
        let side = hull.side(center, half, UndecidedConstraints::MAX);
        decided += usize::from(!matches!(side, Side::Across(_)));
        for _ in 0..20 {
            let offset =
                Vector3::new(uniform() - 0.5, uniform() - 0.5, uniform() - 0.5) * 2.0 * half;
            let value = hull.value(center + offset, UndecidedConstraints::MAX);
            match side {
                Side::Across(undecided) => {
                    let told = hull.value(center + offset, undecided);
                    assert_eq!(told > 0.0, value > 0.0, "{told} for {value}");
                }
                side => assert_eq!(value > 0.0, side == Side::Inside),
            }
        }
    }
    decided
}

#[test]
fn a_picture_that_cuts_the_object_does_not_cut_the_hull() {
    let mut cameras = ring(6, 320, 240);
    // One camera sees half of the ball only.
    let lens = cameras[0].intrinsics;
    let half = Intrinsics::new(160, 240, lens.focal_px, lens.center_px, lens.distortion).unwrap();
    cameras[0] = Camera::new(cameras[0].id.clone(), half, cameras[0].rig_from_camera);
    let levels: Vec<_> = cameras.iter().map(|c| ball_silhouette(c, 0.05)).collect();
    let found = surface_of(&cameras, &levels, cube(0.08), &Parameters::default());
    let vertices = || found.surface.mesh.vertices.iter();
    let first = found.surface.mesh.vertices[0];
    let low = vertices().fold(first, |low, v| low.inf(v));
    let high = vertices().fold(first, |high, v| high.sup(v));
    for axis in 0..2 {
        assert!(low[axis] < -0.0495 && high[axis] > 0.0495, "{low} {high}");
    }
}

#[test]
fn an_object_outside_the_volume_is_an_error_that_names_a_camera() {
    let cameras = ring(4, 160, 120);
    let levels: Vec<_> = cameras
        .iter()
        .map(|c| Grid::filled(c.intrinsics.width, c.intrinsics.height, 0))
        .collect();
    let cones = cameras
        .iter()
        .zip(&levels)
        .map(|(c, l)| Cone::new(c, l))
        .collect();
    let error = lattice(&Hull::new(cones, cube(0.02), 2), &Parameters::default()).unwrap_err();
    assert!(error.to_string().contains("camera c00"), "{error}");
}

#[test]
fn the_volume_cuts_what_stands_on_the_table() {
    let cameras = ring(5, 320, 240);
    let levels: Vec<_> = cameras.iter().map(|c| ball_silhouette(c, 0.05)).collect();
    let volume = Volume::new(Point3::new(-0.07, -0.07, 0.0), Point3::new(0.07, 0.07, 0.1)).unwrap();
    let ExtractedSurface { surface, .. } =
        surface_of(&cameras, &levels, volume, &Parameters::default());
    assert!(mesh::check(&surface.mesh).is_watertight());
    let on_floor = |v: usize| surface.mesh.vertices[v].z < 1e-4;
    let floor = (0..surface.mesh.vertices.len()).filter(|&v| is_floor(surface.constraints[v]));
    assert!(floor.clone().count() > 500);
    assert!(floor.clone().all(on_floor), "only the floor is the table");
}

#[test]
fn a_cell_size_of_another_unit_is_refused_by_its_name() {
    let cameras = ring(6, 200, 150);
    let levels: Vec<_> = cameras.iter().map(|c| ball_silhouette(c, 0.03)).collect();
    let refused = |cell_size: f64| {
        let pairs = cameras.iter().zip(&levels);
        let cones = pairs.map(|(c, l)| Cone::new(c, l)).collect();
        let asked = Parameters {
            cell_size,
            ..Parameters::default()
        };
        let found = lattice(&Hull::new(cones, cube(0.05), 2), &asked);
        found.err().map(|error| error.to_string())
    };
    assert_eq!(refused(1e-3), None);
    for cell_size in [1.0, 1e-6] {
        let words = refused(cell_size).unwrap();
        assert!(words.starts_with("hull.cell_size is"), "{words}");
    }
}

/// What a camera ignores is as what lies beyond its frame: the cone that the others leave stays whole there.
#[test]
fn a_camera_says_nothing_of_what_it_ignores() {
    let (radius, cameras) = (0.05, ring(7, 320, 240));
    let levels: Vec<_> = cameras.iter().map(|c| ball_silhouette(c, radius)).collect();
    let none = Grid::filled(320, 240, 0_u8);
    let all = Grid::filled(320, 240, 255_u8);
    let left = Grid::from_fn(320, 240, |x, _| if x < 160 { 255 } else { 0 });
    let hull_of = |ignored: [&Grid<u8>; 7]| {
        let parameters = Parameters::default();
        let each = cameras.iter().zip(&levels).zip(ignored);
        let cones = each
            .map(|((c, l), i)| Cone::with_unknown(c, l, Some(i)))
            .collect();
        let hull = Hull::new(cones, cube(0.08), 2);
        let lattice = lattice(&hull, &parameters).unwrap();
        let made = extract(&hull, &lattice, &parameters).unwrap();
        assert!(mesh::check(&made.surface.mesh).is_watertight());
        (made.surface.mesh, hull.unproved_volume().unwrap())
    };
    let volume = |mesh: &mesh::Mesh| mesh::volume_and_total_area(mesh).0;
    let plain = surface_of(&cameras, &levels, cube(0.08), &Parameters::default());
    let (whole, unproved) = hull_of([&none; 7]);
    assert_eq!(whole, plain.surface.mesh);
    assert_eq!(unproved, 0.0);
    // A camera that ignores all is a camera less.
    let (without, _) = hull_of([&none, &none, &all, &none, &none, &none, &none]);
    let others: Vec<_> = (0..7).filter(|&i| i != 2).collect();
    let (few, few_levels): (Vec<_>, Vec<_>) = others
        .iter()
        .map(|&i| (cameras[i].clone(), levels[i].clone()))
        .unzip();
    let expected = surface_of(&few, &few_levels, cube(0.08), &Parameters::default());
    let ratio = volume(&without) / volume(&expected.surface.mesh);
    assert!((ratio - 1.0).abs() < 1e-3, "{ratio}");
    // One that ignores a half carves less than it did and more than nothing.
    let (half, unproved) = hull_of([&none, &none, &left, &none, &none, &none, &none]);
    assert!(volume(&half) > volume(&whole) * 1.0005);
    assert!(volume(&half) < volume(&without));
    assert_eq!(unproved, 0.0);
    // What all ignore is not object, and is counted.
    let top = |camera: &Camera| {
        Grid::from_fn(320, 240, |x, y| {
            let ray = camera.ray(Point2::new(x as f64, y as f64)).unwrap();
            let to_top = Point3::new(0.0, 0.0, 0.045) - camera.center();
            if to_top.cross(&ray.normalize()).norm() < 0.02 {
                255
            } else {
                0
            }
        })
    };
    let tops: Vec<Grid<u8>> = cameras.iter().map(top).collect();
    let each = cameras.iter().zip(&levels).zip(&tops);
    let cones = each
        .map(|((c, l), i)| Cone::with_unknown(c, l, Some(i)))
        .collect();
    let hull = Hull::new(cones, cube(0.08), 2);
    let unproved = hull.unproved_volume().unwrap();
    assert!((2e-5..5e-5).contains(&unproved), "{unproved}");
    assert!(hull.value(Point3::new(0.0, 0.0, 0.045), UndecidedConstraints::MAX) < 0.0);
    assert!(hull.value(Point3::origin(), UndecidedConstraints::MAX) > 0.0);
}
