//! Pictures of meshes for people: coloured, shaded by a light at the eye, with smooth edges. The caller gives the
//! projection, so this file knows no camera.

use super::{Fragment, Mesh, rasterize, rasterize_closed};
use crate::array::three;
use crate::image::{Grid, RgbImage};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Where a picture is seen from: lights the mesh, and tells a perspective projection from a parallel one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ProjectionKind {
    /// A perspective view from this point.
    At(Point3<f32>),
    /// A parallel view; the unit vector points from the object to the eye.
    Towards(Vector3<f32>),
}

/// A way to look at a mesh: the picture's size and how points come into it.
#[derive(Clone, Copy, Debug)]
pub struct View<P> {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Where it is seen from.
    pub eye: ProjectionKind,
    /// A point's pixel coordinates and depth, as [`rasterize`] wants them.
    pub project: P,
}

/// How a picture is drawn.
#[derive(Clone, Copy, Debug)]
pub struct Style<'a> {
    /// Colour where the mesh is not.
    pub background: [u8; 3],
    /// Light that falls everywhere, in [0, 1]; the rest depends on the angle to the eye. 1 is unshaded.
    pub ambient: f32,
    /// Unit normals, a vertex each, for smooth shading; `None` shades each triangle flat.
    pub normals: Option<&'a [Vector3<f32>]>,
    /// Samples a pixel along each axis.
    pub supersampling: usize,
}

impl Default for Style<'_> {
    fn default() -> Self {
        Self {
            background: [255; 3],
            ambient: 0.35,
            normals: None,
            supersampling: 3,
        }
    }
}

/// Draws `mesh` as `view` sees it. `paint` gives the colour at a point of the surface from the triangle's
/// index and the point's weights of its three corners.
pub fn render<P: Fn(Point3<f32>) -> [f32; 3]>(
    mesh: &Mesh,
    view: &View<P>,
    style: &Style,
    paint: impl Fn(usize, [f32; 3]) -> [u8; 3] + Sync,
) -> RgbImage {
    Drawn::new(mesh, view, style.supersampling).paint(style, paint)
}

/// A mesh that was drawn once and can be painted more than once.
pub struct Drawn<'a> {
    mesh: &'a Mesh,
    eye: ProjectionKind,
    samples: usize,
    /// Of the vertices, at the resolution of the samples.
    projected: Vec<[f32; 3]>,
    buffer: Grid<Fragment>,
}

impl<'a> Drawn<'a> {
    /// Draws `mesh` as `view` sees it, with this many samples a pixel along each axis (1 to 8).
    pub fn new<P: Fn(Point3<f32>) -> [f32; 3]>(
        mesh: &'a Mesh,
        view: &View<P>,
        samples: usize,
    ) -> Self {
        Self::by(rasterize, mesh, view, samples)
    }

    /// [`Self::new`] for a closed surface that the eye is outside of, in half the time.
    pub fn closed<P: Fn(Point3<f32>) -> [f32; 3]>(
        mesh: &'a Mesh,
        view: &View<P>,
        samples: usize,
    ) -> Self {
        Self::by(rasterize_closed, mesh, view, samples)
    }

    fn by<P: Fn(Point3<f32>) -> [f32; 3]>(
        rasterize: impl Fn(&[[f32; 3]], &[[u32; 3]], usize, usize) -> Grid<Fragment>,
        mesh: &'a Mesh,
        view: &View<P>,
        samples: usize,
    ) -> Self {
        let samples = samples.clamp(1, 8);
        let project = |&v: &Point3<f32>| supersampled((view.project)(v), samples);
        let projected: Vec<_> = mesh.vertices.iter().map(project).collect();
        let (width, height) = (view.width * samples, view.height * samples);
        Self {
            buffer: rasterize(&projected, &mesh.triangles, width, height),
            mesh,
            eye: view.eye,
            samples,
            projected,
        }
    }

    /// Paints what was drawn; the style's supersampling is not used. `paint` as for [`render`].
    pub fn paint(
        &self,
        style: &Style,
        paint: impl Fn(usize, [f32; 3]) -> [u8; 3] + Sync,
    ) -> RgbImage {
        let shade = |x: usize, y: usize, fragment: &Fragment| {
            if !fragment.is_covered() {
                return style.background;
            }
            let triangle = fragment.triangle as usize;
            let vertices = self.mesh.triangles[triangle];
            let corners = three(|i| self.projected[vertices[i] as usize]);
            let weights = weights_at(corners, x as f32, y as f32, self.eye);
            let light = light(self.mesh, triangle, weights, self.eye, style);
            let color = paint(triangle, weights);
            three(|c| (f32::from(color[c]) * light + 0.5) as u8)
        };
        average(&self.buffer, self.samples, shade)
    }
}

/// For [`render`]: every vertex has a colour, and triangles blend theirs.
pub fn vertex_paint<'a>(
    mesh: &'a Mesh,
    colors: &'a [[u8; 3]],
) -> impl Fn(usize, [f32; 3]) -> [u8; 3] + Sync + 'a {
    move |triangle, weights| {
        let corners = three(|i| colors[mesh.triangles[triangle][i] as usize]);
        three(|channel| {
            let blended = (0..3).map(|i| weights[i] * f32::from(corners[i][channel]));
            (blended.sum::<f32>() + 0.5) as u8
        })
    }
}

/// A parallel view towards the origin of the unit vector `towards_eye` that fits every mesh within `radius` of
/// `centre`, upright by +z (by +y where it looks along z).
pub fn parallel_view(
    centre: Point3<f32>,
    radius: f32,
    towards_eye: Vector3<f32>,
    (width, height): (usize, usize),
) -> View<impl Fn(Point3<f32>) -> [f32; 3] + Sync> {
    let up = if towards_eye.z.abs() > 0.999 {
        Vector3::y()
    } else {
        Vector3::z()
    };
    let right = up.cross(&towards_eye).normalize();
    let down = towards_eye.cross(&right) * -1.0;
    let scale = 0.5 * width.min(height) as f32 / radius.max(f32::MIN_POSITIVE);
    let middle = [0.5 * (width as f32 - 1.0), 0.5 * (height as f32 - 1.0)];
    let project = move |p: Point3<f32>| {
        let from_centre = p - centre;
        // From 0 at the farthest to 1 at the nearest. Its shifted reciprocal is a depth that z-buffers, which
        // interpolate reciprocals, interpolate exactly.
        let nearness = 0.5 + 0.5 * from_centre.dot(&towards_eye) / radius;
        [
            middle[0] + scale * from_centre.dot(&right),
            middle[1] + scale * from_centre.dot(&down),
            (1.0 + nearness).recip(),
        ]
    };
    View {
        width,
        height,
        eye: ProjectionKind::Towards(towards_eye),
        project,
    }
}

/// The four standard sides, as unit vectors towards the eye, `elevation` radians above the table: from the
/// front (−y), the right (+x), the back and the left.
pub fn four_sides(elevation: f32) -> [(&'static str, Vector3<f32>); 4] {
    let (sin, cos) = elevation.sin_cos();
    [
        ("front", Vector3::new(0.0, -cos, sin)),
        ("right", Vector3::new(cos, 0.0, sin)),
        ("back", Vector3::new(0.0, cos, sin)),
        ("left", Vector3::new(-cos, 0.0, sin)),
    ]
}

/// Pixel centres are at whole numbers, so a picture's left edge is at −0.5 at any resolution.
fn supersampled([x, y, depth]: [f32; 3], samples: usize) -> [f32; 3] {
    let scale = samples as f32;
    [(x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5, depth]
}

/// The weights of a triangle's corners at a pixel it covers, of sum 1 and within [0, 1].
fn weights_at(corners: [[f32; 3]; 3], x: f32, y: f32, eye: ProjectionKind) -> [f32; 3] {
    let [a, b, c] = three(|i| [corners[i][0] - x, corners[i][1] - y]);
    let cross = |p: [f32; 2], q: [f32; 2]| p[0] * q[1] - p[1] * q[0];
    let mut weights = [cross(b, c), cross(c, a), cross(a, b)];
    if let ProjectionKind::At(_) = eye {
        for i in 0..3 {
            weights[i] /= corners[i][2];
        }
    }
    let sum: f32 = weights.iter().sum();
    three(|i| (weights[i] / sum).clamp(0.0, 1.0))
}

fn light(
    mesh: &Mesh,
    triangle: usize,
    weights: [f32; 3],
    eye: ProjectionKind,
    style: &Style,
) -> f32 {
    let [a, b, c] = mesh.corners(triangle);
    let normal = match style.normals {
        Some(normals) => {
            let [i, j, k] = mesh.triangles[triangle];
            normals[i as usize] * weights[0]
                + normals[j as usize] * weights[1]
                + normals[k as usize] * weights[2]
        }
        None => (b - a).cross(&(c - a)),
    };
    let towards_eye = match eye {
        ProjectionKind::Towards(direction) => direction,
        ProjectionKind::At(point) => point - a,
    };
    let lengths = (normal.norm_squared() * towards_eye.norm_squared()).sqrt();
    // The inside of an open mesh is lit as its outside is.
    let cosine = normal.dot(&towards_eye).abs() / lengths.max(f32::MIN_POSITIVE);
    style.ambient + (1.0 - style.ambient) * cosine.min(1.0)
}

/// The mean of the samples of each pixel, in sRGB as it is: good enough for edges in a figure.
fn average(
    buffer: &Grid<Fragment>,
    samples: usize,
    shade: impl Fn(usize, usize, &Fragment) -> [u8; 3] + Sync,
) -> RgbImage {
    let (width, height) = (buffer.width() / samples, buffer.height() / samples);
    let pixel = |x: usize, y: usize| {
        let (left, top) = (x * samples, y * samples);
        let mut sum = [0_u32; 3];
        for y in top..top + samples {
            let row = &buffer.row(y)[left..left + samples];
            for (x, fragment) in row.iter().enumerate() {
                let color = shade(left + x, y, fragment);
                (0..3).for_each(|i| sum[i] += u32::from(color[i]));
            }
        }
        let count = (samples * samples) as u32;
        three(|i| ((sum[i] + count / 2) / count) as u8)
    };
    let mut picture = RgbImage::filled(width, height, [0; 3]);
    let rows = picture.pixels_mut().par_chunks_mut(width.max(1));
    rows.enumerate().for_each(|(y, row)| {
        for (x, out) in row.iter_mut().enumerate() {
            *out = pixel(x, y);
        }
    });
    picture
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{shapes, vertex_normals};

    fn view_of_unit(towards: Vector3<f32>) -> View<impl Fn(Point3<f32>) -> [f32; 3]> {
        parallel_view(Point3::origin(), 1.0, towards, (41, 41))
    }

    #[test]
    fn a_ball_fills_the_view_and_is_brightest_in_the_middle() {
        let ball = shapes::sphere(1.0, 4);
        let normals = vertex_normals(&ball);
        let style = Style {
            normals: Some(&normals),
            ..Style::default()
        };
        for (_, towards) in four_sides(0.4) {
            let image = render(&ball, &view_of_unit(towards), &style, |_, _| [200, 100, 0]);
            assert_eq!(image[(0, 0)], [255; 3]);
            let middle = image[(20, 20)];
            assert!(
                (198..=200).contains(&middle[0]) && middle[2] == 0,
                "{middle:?}"
            );
            assert!(image[(20, 2)][0] < 160, "{:?}", image[(20, 2)]);
            let covered = image.pixels().iter().filter(|p| p[2] < 128).count() as f32;
            let disc = std::f32::consts::PI * 20.5 * 20.5;
            assert!((covered / disc - 1.0).abs() < 0.03, "{covered} of {disc}");
        }
    }

    #[test]
    fn each_side_shows_its_own_face_the_right_way_up() {
        let cube = shapes::cube(0.5);
        // By the triangle's normal: red for ±x, green for ±y, blue for ±z.
        let paint = |triangle: usize, _: [f32; 3]| {
            let [a, b, c] = cube.corners(triangle);
            let normal = (b - a).cross(&(c - a)).normalize();
            [normal.x, normal.y, normal.z].map(|v| if v > 0.5 { 250 } else { 0 })
        };
        let style = Style {
            ambient: 1.0,
            ..Style::default()
        };
        let seen = |towards| render(&cube, &view_of_unit(towards), &style, paint)[(20, 20)];
        let sides = four_sides(0.0);
        assert_eq!(
            sides.map(|(name, _)| name),
            ["front", "right", "back", "left"]
        );
        assert_eq!(seen(sides[0].1), [0, 0, 0]);
        assert_eq!(seen(sides[1].1), [250, 0, 0]);
        assert_eq!(seen(sides[2].1), [0, 250, 0]);
        assert_eq!(seen(Vector3::z()), [0, 0, 250]);
        // From above the front the top face is in the upper half, and +x is to the right.
        let image = render(&cube, &view_of_unit(four_sides(0.6)[0].1), &style, paint);
        assert_eq!(image[(20, 8)], [0, 0, 250]);
        assert_eq!(image[(20, 28)], [0, 0, 0]);
        let project = view_of_unit(sides[0].1).project;
        assert!(project(Point3::new(0.5, 0.0, 0.0))[0] > 20.0);
    }

    #[test]
    fn colours_blend_between_vertices_and_edges_are_smooth() {
        let mesh = Mesh {
            vertices: vec![
                Point3::new(-1.0, 0.0, -1.0),
                Point3::new(1.0, 0.0, -1.0),
                Point3::new(0.0, 0.0, 1.0),
            ],
            triangles: vec![[0, 1, 2]],
        };
        let colors = [[0; 3], [200, 0, 0], [0, 0, 100]];
        let style = Style {
            ambient: 1.0,
            ..Style::default()
        };
        let view = parallel_view(Point3::origin(), 1.0, -Vector3::y(), (41, 41));
        let image = render(&mesh, &view, &style, vertex_paint(&mesh, &colors));
        assert_eq!(image[(20, 20)], [50, 0, 50]);
        assert!(image.pixels().iter().any(|p| (100..230).contains(&p[1])));
    }

    #[test]
    fn meshes_of_nothing_and_not_finite_give_the_background() {
        let mut broken = shapes::cube(1.0);
        broken.vertices.iter_mut().for_each(|v| v.x = f32::NAN);
        for mesh in [Mesh::default(), broken] {
            let view = view_of_unit(-Vector3::y());
            let image = render(&mesh, &view, &Style::default(), |_, _| [0; 3]);
            assert!(image.pixels().iter().all(|p| *p == [255; 3]));
        }
    }
}
