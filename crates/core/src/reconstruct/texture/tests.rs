//! Tests of the whole painter on surfaces of known colour, rendered into a few cameras.

use super::*;
use crate::calibration::{Camera, DepthCamera, DepthResponse, Distortion, Intrinsics, Volume};
use crate::frame::CameraId;
use crate::image::{Grid, RgbImage};
use crate::mesh::{Fragment, rasterize_mesh, shapes};
use crate::reconstruct::{ColorView, DepthFrame, DepthView, Provenance, SilhouetteSource};
use nalgebra::{
    Isometry3, Matrix3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector2,
};
use proptest::prelude::*;
use std::sync::Arc;

const BACKDROP: [u8; 3] = [0, 0, 255];

/// A camera at `eye` that looks at the origin.
fn camera(eye: [f64; 3], side: usize, focal_px: f64) -> Camera {
    let eye = Vector3::from(eye);
    let z = -eye.normalize();
    let up = if z.z.abs() > 0.99 {
        Vector3::y()
    } else {
        Vector3::z()
    };
    let x = z.cross(&up).normalize();
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    let center = (side as f64 - 1.0) / 2.0;
    let lens = Intrinsics::new(
        side,
        side,
        Vector2::repeat(focal_px),
        Vector2::repeat(center),
        Distortion::default(),
    );
    let pose = Isometry3::from_parts(
        Translation3::from(eye),
        UnitQuaternion::from_rotation_matrix(&rotation),
    );
    Camera::new(CameraId::new("c").unwrap(), lens.unwrap(), pose)
}

/// Cameras around the origin at 0.5 m, and one above.
fn ring(count: usize, side: usize, focal_px: f64) -> Vec<Camera> {
    let around = (0..count).map(|i| {
        let angle = std::f64::consts::TAU * i as f64 / count as f64;
        camera(
            [0.48 * angle.cos(), 0.48 * angle.sin(), 0.14],
            side,
            focal_px,
        )
    });
    around
        .chain([camera([0.0, 0.0, 0.5], side, focal_px)])
        .collect()
}

/// Renders a mesh whose colour depends on the place alone.
fn render(camera: &Camera, mesh: &Mesh, color: impl Fn(Point3<f64>) -> [f64; 3]) -> RgbImage {
    let lens = &camera.intrinsics;
    let buffer: Grid<Fragment> = rasterize_mesh(
        mesh,
        |p| camera.project_for_raster(p),
        lens.width,
        lens.height,
    );
    let axis = camera.rig_from_camera.rotation * Vector3::z();
    RgbImage::from_fn(lens.width, lens.height, |x, y| {
        let fragment = buffer[(x, y)];
        if !fragment.is_covered() {
            return BACKDROP;
        }
        let ray = camera.ray(Point2::new(x as f64, y as f64)).unwrap();
        let p = camera.center() + ray * (f64::from(fragment.depth) / ray.dot(&axis));
        color(p).map(|c| c.round().clamp(0.0, 255.0) as u8)
    })
}

/// Smooth stripes and patches, 50 to 200.
fn pattern(p: Point3<f64>) -> [f64; 3] {
    let wave = |k: Vector3<f64>| 125.0 + 75.0 * (p.coords.dot(&k) + 1.0).sin();
    [
        wave(Vector3::new(120.0, 40.0, 90.0)),
        wave(Vector3::new(-70.0, 110.0, 60.0)),
        wave(Vector3::new(30.0, -80.0, 130.0)),
    ]
}

fn model(mesh: Mesh) -> Model {
    Model {
        normals: mesh::vertex_normals(&mesh),
        provenance: vec![Provenance::Hull; mesh.vertices.len()],
        expected_error: vec![0.0; mesh.vertices.len()],
        captures: Vec::new(),
        texture: None,
        mesh,
    }
}

fn scene(views: Vec<(Camera, RgbImage)>) -> Scene {
    let view = |(camera, image): (Camera, RgbImage)| ColorView {
        camera,
        silhouette: SilhouetteSource::Background(Arc::new(RgbImage::default())),
        ignored: None,
        image,
    };
    Scene {
        colors: views.into_iter().map(view).collect(),
        depths: Vec::new(),
        volume: Volume::new(Point3::new(-1.0, -1.0, -1.0), Point3::new(1.0, 1.0, 1.0)).unwrap(),
    }
}

fn rendered(cameras: Vec<Camera>, mesh: &Mesh, color: impl Fn(Point3<f64>) -> [f64; 3]) -> Scene {
    let views = cameras.into_iter().map(|camera| {
        let image = render(&camera, mesh, &color);
        (camera, image)
    });
    scene(views.collect())
}

fn sphere() -> Model {
    model(shapes::sphere(0.05, 5))
}

/// The atlas' colour where a triangle's point is, given by its shares of the corners.
fn look_up(texture: &Texture, triangle: usize, shares: [f32; 3]) -> Vector3<f64> {
    let uv = texture.corner_uv[triangle];
    let size = [texture.atlas.width(), texture.atlas.height()];
    let [x, y] = [0, 1].map(|i| {
        let u: f32 = (0..3).map(|c| uv[c][i] * shares[c]).sum();
        (u * size[i] as f32 - 0.5).clamp(0.0, size[i] as f32 - 1.0)
    });
    let at = |dx: usize, dy: usize| {
        let (x, y) = (
            (x as usize + dx).min(size[0] - 1),
            (y as usize + dy).min(size[1] - 1),
        );
        Vector3::from(texture.atlas[(x, y)]).cast::<f64>()
    };
    let (fx, fy) = (f64::from(x.fract()), f64::from(y.fract()));
    let top = at(0, 0).lerp(&at(1, 0), fx);
    top.lerp(&at(0, 1).lerp(&at(1, 1), fx), fy)
}

/// Mean absolute difference of the atlas to the truth over the middles of the triangles that are seen.
fn error_in_triangles(
    model: &Model,
    texture: &Texture,
    truth: impl Fn(Point3<f64>) -> [f64; 3],
) -> f64 {
    error_where(model, texture, truth, |_| true)
}

/// The same over those whose middles are wanted.
fn error_where(
    model: &Model,
    texture: &Texture,
    truth: impl Fn(Point3<f64>) -> [f64; 3],
    is_wanted: impl Fn(Point3<f64>) -> bool,
) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for triangle in (0..texture.seen.len()).filter(|&t| texture.seen[t]) {
        let corners = model.mesh.corners(triangle).map(|c| c.coords);
        let middle = Point3::from((corners[0] + corners[1] + corners[2]) / 3.0).cast();
        if !is_wanted(middle) {
            continue;
        }
        let found = look_up(texture, triangle, [1.0 / 3.0; 3]);
        sum += (found - Vector3::from(truth(middle))).abs().mean();
        count += 1.0;
    }
    sum / count
}

#[test]
fn colors_are_those_of_the_surface() {
    let model = sphere();
    let scene = rendered(ring(5, 480, 1500.0), &model.mesh, pattern);
    let texture = paint(&model, &scene, &[], &Parameters::default());
    let seen = texture.seen.iter().filter(|&&s| s).count();
    assert!(
        seen * 100 > texture.seen.len() * 85,
        "{seen} of {}",
        texture.seen.len()
    );
    let error = error_in_triangles(&model, &texture, pattern);
    assert!(error < 2.0, "mean error {error}");
    let seen_vertex = |v: &usize| model.mesh.vertices[*v].z > 0.0;
    let errors = (0..model.mesh.vertices.len()).filter(seen_vertex).map(|v| {
        let truth = Vector3::from(pattern(model.mesh.vertices[v].cast()));
        (Vector3::from(texture.vertex_colors[v]).cast() - truth)
            .abs()
            .mean()
    });
    let errors: Vec<f64> = errors.collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let worst = errors.iter().copied().fold(0.0, f64::max);
    assert!(
        mean < 2.0 && worst < 16.0,
        "vertices: mean {mean}, worst {worst}"
    );
}

/// sRGB's encoding of a factor of the light.
fn exposed(value: u8, factor: f64) -> u8 {
    let encoded = f64::from(value) / 255.0;
    let linear = if encoded <= 0.040_45 {
        encoded / 12.92
    } else {
        ((encoded + 0.055) / 1.055).powf(2.4)
    };
    let linear = (linear * factor).min(1.0);
    let encoded = if linear <= 0.003_130_8 {
        linear * 12.92
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    };
    (encoded * 255.0).round() as u8
}

/// A sphere whose cameras differ in exposure by up to 15 % either way.
fn unevenly_exposed(model: &Model, color: impl Fn(Point3<f64>) -> [f64; 3]) -> Scene {
    let mut scene = rendered(ring(5, 480, 1500.0), &model.mesh, color);
    let factors = [0.85, 1.15, 0.95, 1.1, 0.9, 1.05];
    for (view, factor) in scene.colors.iter_mut().zip(factors) {
        view.image = view.image.map(|p| p.map(|c| exposed(c, factor)));
    }
    scene
}

#[test]
fn exposures_are_evened_out() {
    let model = sphere();
    let scene = unevenly_exposed(&model, pattern);
    let surface = Surface::new(
        &model.mesh,
        &scene,
        &[],
        &ViewPriority::default(),
        &Parameters::default(),
    );
    let gains = exposure::even_out(&surface);
    let samples = exposure::samples(&surface, &gains);
    let mut ratios = Vec::new();
    for (view, sights) in surface.sights.iter().enumerate() {
        let (mut found, mut truth) = (0.0, 0.0);
        for v in (0..sights.len()).filter(|&v| sights[v] == Visibility::Safe) {
            found += f64::from(samples[view][v].sum());
            truth += pattern(model.mesh.vertices[v].cast()).iter().sum::<f64>();
        }
        ratios.push(found / truth);
    }
    let low = ratios.iter().copied().fold(f64::INFINITY, f64::min);
    let high = ratios.iter().copied().fold(0.0, f64::max);
    assert!(high / low < 1.02, "{ratios:?}");
    let mean = gains.iter().map(|g| g.mean()).sum::<f32>() / gains.len() as f32;
    assert!((mean - 1.0).abs() < 0.01, "mean gain {mean}");
}

/// A plate of 10 cm, whose faces lie 2 mm above and below the origin.
fn plate() -> Model {
    model(grid_box([-0.05, -0.05, -0.002], [0.05, 0.05, 0.002]))
}

#[test]
fn a_camera_that_shares_nothing_with_others_has_the_gain_of_its_capture() {
    let model = plate();
    // The second capture sees both sides, in less light; its back is seen by no other camera.
    let cameras = [[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, -0.5]];
    let cameras = cameras.map(|eye| camera(eye, 480, 1500.0));
    let mut scene = rendered(cameras.to_vec(), &model.mesh, pattern);
    for view in &mut scene.colors[1..] {
        view.image = view.image.map(|p| p.map(|c| exposed(c, 0.7)));
    }
    let gains = |captures: &[u16]| {
        let order = ViewPriority {
            ranks: &[],
            captures,
        };
        let surface = Surface::new(&model.mesh, &scene, &[], &order, &Parameters::default());
        exposure::even_out(&surface)
            .iter()
            .map(|g| g.mean())
            .collect::<Vec<f32>>()
    };
    let of_two = gains(&[0, 1, 1]);
    assert!(of_two[1] / of_two[0] > 1.1, "{of_two:?}");
    assert!((of_two[2] / of_two[1] - 1.0).abs() < 0.03, "{of_two:?}");
    // Of one capture nothing is known of that camera.
    let of_one = gains(&[]);
    assert!(of_one[1] / of_one[2] > 1.05, "{of_one:?}");
}

#[test]
fn a_capture_of_a_higher_rank_paints_only_what_no_other_sees() {
    /// The pattern after half a turn about the vertical.
    fn turned(p: Point3<f64>) -> [f64; 3] {
        pattern(Point3::new(-p.x, -p.y, p.z))
    }
    let model = plate();
    // The first capture sees less of the upper side's detail, and nothing of the lower side.
    let cameras = [[0.0, 0.0, 0.7], [0.0, 0.0, 0.5], [0.0, 0.0, -0.5]];
    let [far, near, below] = cameras.map(|eye| camera(eye, 480, 1500.0));
    let first = render(&far, &model.mesh, pattern);
    let [second, third] = [&near, &below].map(|c| render(c, &model.mesh, turned));
    let scene = scene(vec![(far, first), (near, second), (below, third)]);
    let errors = |ranks: &[u8]| {
        let order = ViewPriority {
            ranks,
            captures: &[0, 1, 1],
        };
        // Colours are not drawn to the mean of both captures, whose patterns are two.
        let parameters = Parameters {
            level_rings: 0,
            ..Parameters::default()
        };
        let texture = paint_in_order(&model, &scene, &[], &order, &parameters);
        let above = error_where(&model, &texture, pattern, |p| p.z > 0.0019);
        let below = error_where(&model, &texture, turned, |p| p.z < -0.0019);
        [above, below]
    };
    let ranked = errors(&[0, 1, 1]);
    assert!(ranked.iter().all(|&e| e < 6.0), "{ranked:?}");
    // Without ranks the camera that sees more detail paints the upper side.
    let [above, _] = errors(&[]);
    assert!(above > 20.0, "{above}");
}

/// Mean step of colour between the middles of neighbouring triangles: across seams, and inside charts.
fn steps(model: &Model, texture: &Texture) -> [f64; 2] {
    let rings = Rings::new(&model.mesh);
    let middle = |t: usize| look_up(texture, t, [1.0 / 3.0; 3]);
    let mut sums = [[0.0, 0.0]; 2];
    for (t, across) in rings.across(&model.mesh).iter().enumerate() {
        for &n in across.iter().filter(|&&n| n as usize > t) {
            let n = n as usize;
            if !texture.seen[t] || !texture.seen[n] {
                continue;
            }
            let shared = texture.corner_uv[n]
                .iter()
                .filter(|uv| texture.corner_uv[t].contains(uv));
            let inside = usize::from(shared.count() >= 2);
            sums[inside][0] += (middle(t) - middle(n)).abs().mean();
            sums[inside][1] += 1.0;
        }
    }
    sums.map(|[sum, count]| sum / f64::max(count, 1.0))
}

#[test]
fn seams_do_not_show() {
    let model = sphere();
    let mut scene = unevenly_exposed(&model, |p| [120.0, 140.0, 160.0 + 400.0 * p.z]);
    for view in &mut scene.colors {
        // A lens that darkens to one side: no single gain takes it away.
        let image = &view.image;
        let shade = |x: usize| 1.0 - 0.3 * x as f64 / 480.0;
        view.image = RgbImage::from_fn(480, 480, |x, y| {
            image[(x, y)].map(|c| (f64::from(c) * shade(x)).round() as u8)
        });
    }
    let painted = |feather_rings, level_rings| {
        let parameters = Parameters {
            feather_rings,
            level_rings,
            ..Parameters::default()
        };
        steps(&model, &paint(&model, &scene, &[], &parameters))
    };
    let [hard, _] = painted(0, 0);
    let default = Parameters::default();
    let [seam, inside] = painted(default.feather_rings, default.level_rings);
    assert!(hard > 3.0, "the test shows nothing: {hard} {inside}");
    assert!(
        seam < inside + 0.3,
        "seams {seam}, inside {inside}, unblended {hard}"
    );
}

/// A plate before two cameras that see it alike but in two greys; the second one sees nothing of the half below x = 0,
/// as if something hid it. Each paints a half.
struct HalfHidden {
    model: Model,
    scene: Scene,
}

impl HalfHidden {
    fn new() -> Self {
        let from_above = camera([0.0, 0.0, 0.5], 480, 1500.0);
        let seen = |grey: u8| (from_above.clone(), RgbImage::filled(480, 480, [grey; 3]));
        Self {
            model: plate(),
            scene: scene(vec![seen(80), seen(200)]),
        }
    }

    fn surface(&self) -> Surface<'_> {
        let order = ViewPriority::default();
        let parameters = Parameters::default();
        let mut surface = Surface::new(&self.model.mesh, &self.scene, &[], &order, &parameters);
        for (sight, p) in surface.sights[1].iter_mut().zip(&self.model.mesh.vertices) {
            if p.x < -1e-4 {
                *sight = Visibility::Hidden;
            }
        }
        surface
    }

    fn labels(&self) -> Vec<u16> {
        let label = |t: usize| {
            let corners = self.model.mesh.corners(t);
            if corners.iter().any(|p| p.z < 0.0019) {
                return labels::UNSEEN;
            }
            u16::from(corners.iter().map(|p| p.x).sum::<f32>() > 0.0)
        };
        (0..self.model.mesh.triangles.len()).map(label).collect()
    }
}

#[test]
fn beside_what_hides_it_from_a_camera_a_surface_is_levelled_in_full() {
    let half_hidden = HalfHidden::new();
    let (model, parameters) = (&half_hidden.model, Parameters::default());
    let (surface, labels) = (half_hidden.surface(), half_hidden.labels());
    let gains: [exposure::Gain; 2] = [Vector3::repeat(1.0); 2];
    let samples = exposure::samples(&surface, &gains);
    let blend = blend::Blend::new(&surface, &labels, &samples, &parameters);
    let layout = charts::Layout::new(&surface, &labels, Vec::new(), &parameters);
    let vertex_colors = vec![Vector3::zeros(); model.mesh.vertices.len()];
    let painted = atlas::Paint {
        surface: &surface,
        gains: &gains,
        blend: &blend,
        vertex_colors: &vertex_colors,
    };
    let texture = Texture {
        atlas: painted.compose(&layout),
        corner_uv: layout.corner_uv(&surface),
        vertex_colors: Vec::new(),
        seen: Vec::new(),
    };
    let first = |v: u32| *blend.of(v as usize).find(|s| s.label == 0).unwrap();
    let mut checked = 0;
    for (t, corners) in model.mesh.triangles.iter().enumerate() {
        for (corner, &v) in corners.iter().enumerate().filter(|_| labels[t] == 0) {
            let p = model.mesh.vertices[v as usize];
            if p.x < -1e-4 || p.y.abs() > 0.02 {
                continue;
            }
            // Here begins the other camera's part, which does not see this triangle.
            assert!(first(v).weight < 0.8 && first(v).offset.x > 15.0);
            let mut shares = [0.1; 3];
            shares[corner] = 0.8;
            let offsets = corners.map(|v| f64::from(first(v).known_offset().x));
            let offset: f64 = (0..3).map(|i| offsets[i] * f64::from(shares[i])).sum();
            let found = look_up(&texture, t, shares).x;
            assert!((found - (80.0 + offset)).abs() < 2.5, "{found} {offset}");
            checked += 1;
        }
    }
    assert!(checked > 20, "{checked}");
}

#[test]
fn what_may_not_paint_hardly_sets_the_level() {
    let half_hidden = HalfHidden::new();
    let (mesh, parameters) = (&half_hidden.model.mesh, Parameters::default());
    let labels = half_hidden.labels();
    let first_only = labels.iter().map(|&label| match label {
        labels::UNSEEN => label,
        _ => 0,
    });
    let first_only: Vec<u16> = first_only.collect();
    let is_middle = |p: &Point3<f32>| p.x.hypot(p.y) < 1e-3 && p.z > 0.0019;
    let middle = mesh.vertices.iter().position(is_middle).unwrap();
    let offset = |ranks: &[u8], is_depth: bool| {
        let order = ViewPriority {
            ranks,
            captures: &[],
        };
        let mut surface = Surface::new(mesh, &half_hidden.scene, &[], &order, &parameters);
        surface.views[1].is_depth = is_depth;
        let samples = exposure::samples(&surface, &[Vector3::repeat(1.0); 2]);
        let blend = blend::Blend::new(&surface, &first_only, &samples, &parameters);
        blend.of(middle).next().unwrap().offset.x
    };
    // The first camera sees 80 and the second one 200; their mean is 140.
    assert!((offset(&[], false) - 60.0).abs() < 1.0);
    assert!(offset(&[0, 1], false) < 2.0);
    assert!(offset(&[], true) < 12.0);
}

/// A wall of colour A at x = 0 and in front of its middle a plate of colour B, both closed boxes.
fn wall_and_plate() -> (Model, impl Fn(Point3<f64>) -> [f64; 3]) {
    let mut mesh = grid_box([-0.01, -0.1, -0.1], [0.0, 0.1, 0.1]);
    let plate = grid_box([0.05, -0.03, -0.03], [0.055, 0.03, 0.03]);
    let offset = mesh.vertices.len() as u32;
    mesh.vertices.extend(plate.vertices);
    mesh.triangles
        .extend(plate.triangles.iter().map(|t| t.map(|v| v + offset)));
    let color = |p: Point3<f64>| {
        if p.x > 0.03 {
            [220.0, 40.0, 40.0]
        } else {
            [40.0, 200.0, 60.0]
        }
    };
    (model(mesh), color)
}

/// A box of triangles of about 2.5 mm.
fn grid_box(low: [f32; 3], high: [f32; 3]) -> Mesh {
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let cells = |k: usize| ((high[k] - low[k]) / 0.0025).round().max(1.0) as u32;
        for (side, flip) in [(high[axis], false), (low[axis], true)] {
            let first = mesh.vertices.len() as u32;
            for j in 0..=cells(v) {
                for i in 0..=cells(u) {
                    let mut p = Point3::origin();
                    p[axis] = side;
                    p[u] = low[u] + (high[u] - low[u]) * i as f32 / cells(u) as f32;
                    p[v] = low[v] + (high[v] - low[v]) * j as f32 / cells(v) as f32;
                    mesh.vertices.push(p);
                }
            }
            for j in 0..cells(v) {
                for i in 0..cells(u) {
                    let a = first + j * (cells(u) + 1) + i;
                    let (b, c, d) = (a + 1, a + cells(u) + 2, a + cells(u) + 1);
                    let pair = [[a, b, c], [a, c, d]];
                    mesh.triangles
                        .extend(pair.map(|[a, b, c]| if flip { [a, c, b] } else { [a, b, c] }));
                }
            }
        }
    }
    mesh
}

#[test]
fn what_is_hidden_does_not_take_the_color_of_what_hides_it() {
    let (model, color) = wall_and_plate();
    let front = vec![camera([0.6, 0.0, 0.0], 400, 900.0)];
    let scene = rendered(front, &model.mesh, &color);
    let parameters = Parameters {
        unseen: Unseen::Continued,
        ..Parameters::default()
    };
    let texture = paint(&model, &scene, &[], &parameters);
    let mut hidden = 0;
    for (t, &seen) in texture.seen.iter().enumerate() {
        let corners = model.mesh.corners(t);
        let on_wall = corners.iter().all(|p| p.x == 0.0);
        let behind = corners.iter().all(|p| p.y.abs() < 0.03 && p.z.abs() < 0.03);
        if on_wall && behind {
            assert!(!seen, "triangle {t} is behind the plate");
            hidden += 1;
        }
        if on_wall {
            let found = look_up(&texture, t, [1.0 / 3.0; 3]);
            assert!(
                found.y > 150.0 && found.x < 100.0,
                "triangle {t}: {found:?}"
            );
        }
    }
    assert!(hidden > 500);
    for (v, p) in model
        .mesh
        .vertices
        .iter()
        .enumerate()
        .filter(|(_, p)| p.x == 0.0)
    {
        let [red, green, _] = texture.vertex_colors[v];
        assert!(
            green > 150 && red < 100,
            "vertex at {p}: {:?}",
            texture.vertex_colors[v]
        );
    }
}

#[test]
fn a_second_camera_sees_past_what_hides() {
    let (model, color) = wall_and_plate();
    let cameras = vec![
        camera([0.6, 0.0, 0.0], 400, 900.0),
        camera([0.35, 0.5, 0.0], 400, 900.0),
    ];
    let scene = rendered(cameras, &model.mesh, &color);
    let texture = paint(&model, &scene, &[], &Parameters::default());
    let wall = |t: &usize| model.mesh.corners(*t).iter().all(|p| p.x == 0.0);
    let seen = (0..texture.seen.len())
        .filter(wall)
        .filter(|&t| texture.seen[t])
        .count();
    let all = (0..texture.seen.len()).filter(wall).count();
    assert!(seen * 100 > all * 96, "{seen} of {all}");
    let error = error_in_triangles(&model, &texture, &color);
    assert!(error < 2.0, "{error}");
}

#[test]
fn nothing_is_painted_from_outside_the_silhouettes() {
    // The model is 4 % larger than the object, so its rim projects onto the backdrop.
    let object = shapes::sphere(0.05, 5);
    let model = model(shapes::sphere(0.052, 5));
    let white = |_: Point3<f64>| [180.0; 3];
    let scene = rendered(ring(5, 480, 1500.0), &object, white);
    let masks: Vec<Mask> = scene
        .colors
        .iter()
        .map(|v| v.image.map(|&p| if p == BACKDROP { 0 } else { 255 }))
        .collect();
    let masks: Vec<&Mask> = masks.iter().collect();
    let texture = paint(&model, &scene, &masks, &Parameters::default());
    for (v, color) in texture.vertex_colors.iter().enumerate() {
        assert!(color[0].abs_diff(color[2]) < 12, "vertex {v}: {color:?}");
    }
    let blue = texture
        .atlas
        .pixels()
        .iter()
        .filter(|p| p[2] > p[0].saturating_add(12));
    assert_eq!(blue.count(), 0);
}

/// A ball that a colour camera sees from the side, and a depth camera from above.
fn with_a_depth_camera(model: &Model) -> Scene {
    let side = camera([0.5, 0.0, -0.1], 480, 1500.0);
    let above = camera([0.0, 0.0, 0.6], 240, 575.0);
    let response = DepthResponse {
        scale: [1.02, 0.0, 0.0, 0.0, 0.0],
        ..DepthResponse::default()
    };
    // The response moves points sideways by its scale: render with a lens that does the same.
    let lens = Intrinsics::new(
        240,
        240,
        Vector2::repeat(575.0 / 1.02),
        Vector2::repeat(119.5),
        Distortion::default(),
    );
    let scaled = Camera::new(above.id.clone(), lens.unwrap(), above.rig_from_camera);
    let picture = Arc::new(render(&scaled, &model.mesh, pattern));
    let frame = || DepthFrame {
        readings: Grid::filled(240, 240, 0),
        color: Some(picture.clone()),
    };
    let mut scene = rendered(vec![side], &model.mesh, pattern);
    scene.depths = vec![DepthView {
        camera: DepthCamera {
            camera: above,
            response,
        },
        frames: vec![frame(), frame()],
    }];
    scene
}

#[test]
fn what_only_the_depth_camera_sees_takes_its_color() {
    let model = sphere();
    let scene = with_a_depth_camera(&model);
    let texture = paint(&model, &scene, &[], &Parameters::default());
    let top = |t: &usize| model.mesh.corners(*t).iter().all(|p| p.z > 0.035);
    assert!((0..texture.seen.len()).filter(top).all(|t| texture.seen[t]));
    let error = error_in_triangles(&model, &texture, pattern);
    assert!(error < 4.0, "{error}");
}

#[test]
fn a_depth_camera_without_colour_paints_nothing() {
    let model = sphere();
    let mut scene = with_a_depth_camera(&model);
    for frame in &mut scene.depths[0].frames {
        frame.color = None;
    }
    let blind = paint(&model, &scene, &[], &Parameters::default());
    scene.depths.clear();
    let without = paint(&model, &scene, &[], &Parameters::default());
    assert_eq!(blind.seen, without.seen);
    assert!(blind.seen.contains(&false));
    assert!(blind.atlas == without.atlas);
    assert_eq!(blind.vertex_colors, without.vertex_colors);
}

#[test]
fn the_atlas_stays_within_its_limit() {
    let model = sphere();
    let scene = rendered(ring(5, 480, 1500.0), &model.mesh, pattern);
    let full = paint(&model, &scene, &[], &Parameters::default()).atlas;
    assert!(full.width() > 300, "{}x{}", full.width(), full.height());
    for largest_side in [256, 64, 8, 1] {
        let parameters = Parameters {
            largest_side,
            ..Parameters::default()
        };
        let texture = paint(&model, &scene, &[], &parameters);
        let atlas = &texture.atlas;
        assert!(atlas.width() <= largest_side && atlas.height() <= largest_side);
        if largest_side == 256 {
            let error = error_in_triangles(&model, &texture, pattern);
            assert!(error < 6.0, "{error}");
        }
        // Where nothing fits, the model shows nothing that a camera saw.
        let fits = atlas.width() * atlas.height() > 1;
        assert_eq!(texture.seen.contains(&true), fits, "{largest_side}");
        let colors = atlas.pixels().iter().chain(&texture.vertex_colors);
        let is_grey = { colors }.all(|&color| color == [128; 3]);
        assert_eq!(is_grey, !fits, "{largest_side}");
    }
}

/// A ball that cameras see only from above, painted.
fn half_seen(unseen: Unseen) -> (Model, Texture) {
    let model = sphere();
    let mut cameras = ring(5, 480, 1500.0);
    cameras.truncate(2);
    let scene = rendered(cameras, &model.mesh, pattern);
    let parameters = Parameters {
        unseen,
        ..Parameters::default()
    };
    let texture = paint(&model, &scene, &[], &parameters);
    (model, texture)
}

#[test]
fn what_nobody_saw_is_grey_unless_colors_are_continued() {
    let colors = |unseen| {
        let (_, texture) = half_seen(unseen);
        let dark = (0..texture.seen.len()).filter(|&t| !texture.seen[t]);
        let colors: Vec<_> = dark.map(|t| look_up(&texture, t, [1.0 / 3.0; 3])).collect();
        assert!(colors.len() > 100, "{}", colors.len());
        colors
    };
    assert!(
        colors(Unseen::Neutral)
            .iter()
            .all(|c| (c - Vector3::repeat(128.0)).norm() < 1e-9)
    );
    let grey = |c: &&Vector3<f64>| (*c - Vector3::repeat(128.0)).norm() < 3.0;
    let continued = colors(Unseen::Continued);
    assert!(continued.iter().filter(grey).count() * 2 < continued.len());
}

#[test]
fn charts_fill_the_atlas() {
    let (model, texture) = half_seen(Unseen::Neutral);
    assert!(error_in_triangles(&model, &texture, pattern) < 4.0);
    // Gutters take their share of so small an atlas.
    assert!(texture.used() > 0.55, "{}", texture.used());
    let all = texture.texel_size(&model.mesh).unwrap();
    // A pixel at half a metre.
    assert!((0.5..3.0).contains(&(all / (0.5 / 1500.0))), "{all}");
}

#[test]
fn a_chart_that_is_turned_shows_the_same_pixels() {
    let model = sphere();
    let scene = rendered(ring(2, 480, 1500.0), &model.mesh, pattern);
    let parameters = Parameters::default();
    let order = ViewPriority::default();
    let surface = Surface::new(&model.mesh, &scene, &[], &order, &parameters);
    let labels = vec![0; model.mesh.triangles.len()];
    let mut layout = charts::Layout::new(&surface, &labels, Vec::new(), &parameters);
    for _ in 0..2 {
        let chart = &layout.charts[0];
        for &v in model.mesh.triangles.as_flattened() {
            let texel = layout.in_chart(&surface, chart, v);
            for (p, side) in texel.into_iter().zip(chart.size) {
                assert!((0.0..=side as f32 - 1.0).contains(&p), "{texel:?}");
            }
            let pixel = layout.pixel(chart, texel);
            let [x, y, _] = surface.views[0].projected[v as usize];
            assert!((pixel[0] - x).abs() < 1e-3 && (pixel[1] - y).abs() < 1e-3);
        }
        if !chart.is_turned {
            layout.charts[0].turn();
        }
    }
    assert!(layout.charts[0].is_turned);
}

#[test]
fn what_is_too_small_for_a_chart_takes_a_color_beside_it_or_is_unseen() {
    let model = sphere();
    let scene = rendered(ring(2, 480, 1500.0), &model.mesh, pattern);
    let parameters = Parameters::default();
    let surface = Surface::new(
        &model.mesh,
        &scene,
        &[],
        &ViewPriority::default(),
        &parameters,
    );
    let mut labels = vec![0; model.mesh.triangles.len()];
    let [speck, other] = [100, surface.across[100][0]];
    labels[speck as usize] = 1;
    let found = specks::find(&surface, &mut labels);
    assert_eq!(found.len(), 1);
    let (triangles, (lender, corner)) = &found[0];
    assert_eq!(triangles, &[speck]);
    assert!(surface.across[speck as usize].contains(lender));
    let shared = model.mesh.triangles[*lender as usize][*corner];
    assert!(model.mesh.triangles[speck as usize].contains(&shared));
    // One of two specks in the unseen lends to the other only what it has itself: nothing.
    let mut labels = vec![labels::UNSEEN; labels.len()];
    (labels[speck as usize], labels[other as usize]) = (1, 0);
    assert!(specks::find(&surface, &mut labels).is_empty());
    assert!(labels.iter().all(|&label| label == labels::UNSEEN));
}

#[test]
fn texture_coordinates_of_a_triangle_hold_its_own_colors() {
    // Every corner lies in the atlas, and no two triangles of different charts share texels.
    let model = sphere();
    let scene = rendered(ring(5, 480, 1500.0), &model.mesh, pattern);
    let texture = paint(&model, &scene, &[], &Parameters::default());
    for uv in texture.corner_uv.as_flattened().as_flattened() {
        assert!((0.0..=1.0).contains(uv));
    }
    let worst = (0..texture.seen.len())
        .filter(|&t| texture.seen[t])
        .map(|t| {
            let corners = model.mesh.corners(t).map(|c| c.coords);
            let p = Point3::from(corners[0] * 0.8 + corners[1] * 0.1 + corners[2] * 0.1).cast();
            (look_up(&texture, t, [0.8, 0.1, 0.1]) - Vector3::from(pattern(p)))
                .abs()
                .max()
        });
    let worst = worst.fold(0.0, f64::max);
    assert!(worst < 40.0, "{worst}");
}

#[test]
fn the_bytes_do_not_depend_on_the_threads() {
    let model = sphere();
    let scene = unevenly_exposed(&model, pattern);
    let painted = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| paint(&model, &scene, &[], &Parameters::default()))
    };
    let (one, three) = (painted(1), painted(3));
    assert!(one.atlas == three.atlas);
    assert_eq!(one.vertex_colors, three.vertex_colors);
    assert_eq!(one.corner_uv, three.corner_uv);
}

fn assert_sound(model: &Model, texture: &Texture) {
    assert_eq!(texture.corner_uv.len(), model.mesh.triangles.len());
    assert_eq!(texture.seen.len(), model.mesh.triangles.len());
    assert_eq!(texture.vertex_colors.len(), model.mesh.vertices.len());
    let uv = texture.corner_uv.as_flattened().as_flattened();
    assert!(uv.iter().all(|u| (0.0..=1.0).contains(u)));
}

#[test]
fn without_a_camera_or_a_surface_there_is_still_a_texture() {
    let blind = paint(&sphere(), &scene(vec![]), &[], &Parameters::default());
    assert_sound(&sphere(), &blind);
    assert!(blind.seen.iter().all(|s| !s));
    assert!(blind.vertex_colors.iter().all(|&c| c == [128; 3]));
    let empty = model(Mesh::default());
    let cameras = ring(2, 100, 300.0);
    let nothing = paint(
        &empty,
        &rendered(cameras, &empty.mesh, pattern),
        &[],
        &Parameters::default(),
    );
    assert_sound(&empty, &nothing);
}

#[test]
fn a_camera_inside_or_turned_away_paints_nothing() {
    let model = sphere();
    let inside = camera([0.001, 0.0, 0.0], 100, 80.0);
    let mut away = camera([0.5, 0.0, 0.0], 100, 80.0);
    let turned = away.rig_from_camera.rotation * UnitQuaternion::from_euler_angles(0.0, 3.1, 0.0);
    away = Camera::new(
        away.id.clone(),
        away.intrinsics,
        Isometry3::from_parts(away.rig_from_camera.translation, turned),
    );
    let scene = rendered(vec![inside, away], &model.mesh, pattern);
    let texture = paint(&model, &scene, &[], &Parameters::default());
    assert_sound(&model, &texture);
    assert!(texture.seen.iter().all(|s| !s));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn any_triangles_are_painted(
        points in prop::collection::vec(prop::array::uniform3(-0.2..0.2f32), 3..20),
        corners in prop::collection::vec(prop::array::uniform3(0..20u32), 0..40),
        spoiled in 0..60usize,
    ) {
        let count = points.len() as u32;
        let mut mesh = Mesh {
            vertices: points.into_iter().map(Point3::from).collect(),
            triangles: corners.into_iter().map(|t| t.map(|v| v % count)).collect(),
        };
        if let Some(p) = mesh.vertices.get_mut(spoiled) {
            p.x = [f32::NAN, f32::INFINITY, 1e30][spoiled % 3];
        }
        let model = model(mesh);
        let scene = rendered(ring(3, 64, 100.0), &model.mesh, pattern);
        let texture = paint(&model, &scene, &[], &Parameters::default());
        assert_sound(&model, &texture);
    }
}
