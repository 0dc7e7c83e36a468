//! Pictures of distances: meshes from four sides and from above, coloured by how far they are from another
//! surface, with a legend.

use super::surface::Surface;
use crate::image::{RgbImage, draw_text, text_size};
use crate::mesh::{
    Mesh, Style, bounding_box, four_sides, parallel_view, render, vertex_normals, vertex_paint,
};
use nalgebra::{Point3, Vector3, center, distance};
use rayon::prelude::*;

/// Side of one view in pixels.
const VIEW: usize = 360;
/// Views in a row: four sides and from above.
const VIEWS: usize = 5;
/// Height of the captions over a row, and width of the margin.
const MARGIN: usize = 28;
/// Height of the strip with the legend.
const LEGEND: usize = 72;
/// Limits that the legend's scale may have, in millimetres.
const LIMITS_MM: [f64; 9] = [0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0];
/// How far above the table the four sides are seen from, in radians: enough to look into a bowl.
const ELEVATION: f32 = 0.5;
const INK: [u8; 3] = [40; 3];

/// One row of a picture: a mesh and a value for each of its vertices.
pub struct Row<'a> {
    /// What it shows, in a few words.
    pub title: &'a str,
    /// What is drawn.
    pub mesh: &'a Mesh,
    /// Signed distances in millimetres, a vertex each.
    pub signed_mm: &'a [f64],
}

/// Signed distances, in millimetres, from `surface` to the vertices of `mesh`.
pub fn vertex_distances(mesh: &Mesh, surface: &Mesh) -> Vec<f64> {
    let surface = Surface::new(surface);
    let distance = |v: &Point3<f32>| {
        let nearest = surface.nearest(v.cast());
        nearest.map_or(0.0, |n| n.signed_distance * 1e3)
    };
    mesh.vertices.par_iter().map(distance).collect()
}

/// Draws each row from the front, the right, the back, the left and above, all at one scale, with one legend:
/// grey is on the surface, red outside of it, blue inside. `headline` stands above.
pub fn draw(headline: &str, rows: &[Row]) -> RgbImage {
    let limit = limit_mm(rows);
    let width = VIEWS * VIEW + 2 * MARGIN;
    let height = MARGIN + rows.len() * (VIEW + MARGIN) + LEGEND;
    let mut picture = RgbImage::filled(width, height, [255; 3]);
    draw_text(&mut picture, (MARGIN as isize, 8), 2, INK, headline);
    let (centre, radius) = enclosing_sphere(rows);
    for (index, row) in rows.iter().enumerate() {
        let top = MARGIN + index * (VIEW + MARGIN);
        let colors: Vec<_> = row.signed_mm.iter().map(|d| color(d / limit)).collect();
        let normals = vertex_normals(row.mesh);
        for (column, (name, towards)) in views().into_iter().enumerate() {
            let view = parallel_view(centre, radius, towards, (VIEW, VIEW));
            let style = Style {
                normals: Some(&normals),
                ..Style::default()
            };
            let drawn = render(row.mesh, &view, &style, vertex_paint(row.mesh, &colors));
            let left = MARGIN + column * VIEW;
            paste(&mut picture, &drawn, (left, top + MARGIN));
            let caption = format!("{}, {name}", row.title);
            draw_text(
                &mut picture,
                (left as isize + 6, top as isize + 14),
                1,
                INK,
                &caption,
            );
        }
    }
    draw_legend(&mut picture, limit);
    picture
}

fn views() -> [(&'static str, Vector3<f32>); VIEWS] {
    let [front, right, back, left] = four_sides(ELEVATION);
    [front, right, back, left, ("above", Vector3::z())]
}

/// The smallest limit that nine of ten distances are within.
fn limit_mm(rows: &[Row]) -> f64 {
    let all = rows.iter().flat_map(|r| r.signed_mm);
    let p90 = super::statistics::Sorted::new(all.map(|d| d.abs())).quantile(0.9);
    let enough = |limit: &f64| *limit >= p90.unwrap_or(0.0);
    let found = LIMITS_MM.into_iter().find(enough);
    found.unwrap_or(LIMITS_MM[LIMITS_MM.len() - 1])
}

fn enclosing_sphere(rows: &[Row]) -> (Point3<f32>, f32) {
    let corners: Vec<Point3<f32>> = rows
        .iter()
        .filter_map(|r| bounding_box(&r.mesh.used_vertices()))
        .flatten()
        .collect();
    match bounding_box(&corners) {
        Some([low, high]) => (center(&low, &high), 0.5 * distance(&low, &high)),
        None => (Point3::origin(), 1.0),
    }
}

/// From −1 (blue) over 0 (light grey) to 1 (red); even in steps, and distinguishable without seeing red
/// and green.
fn color(value: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 5] = [
        [20.0, 50.0, 140.0],
        [90.0, 150.0, 225.0],
        [222.0, 222.0, 222.0],
        [240.0, 140.0, 90.0],
        [165.0, 20.0, 30.0],
    ];
    let at = (value.clamp(-1.0, 1.0) + 1.0) * 2.0;
    let below = (at.floor() as usize).min(STOPS.len() - 2);
    let part = at - below as f64;
    std::array::from_fn(|i| {
        let (a, b) = (STOPS[below][i], STOPS[below + 1][i]);
        (a + (b - a) * part).round() as u8
    })
}

fn paste(picture: &mut RgbImage, part: &RgbImage, (left, top): (usize, usize)) {
    for y in 0..part.height() {
        picture.row_mut(top + y)[left..left + part.width()].copy_from_slice(part.row(y));
    }
}

fn draw_legend(picture: &mut RgbImage, limit: f64) {
    let (left, bar) = (MARGIN, 600);
    let top = picture.height() - LEGEND + 12;
    for y in top..top + 18 {
        for x in 0..bar {
            let value = 2.0 * x as f64 / (bar - 1) as f64 - 1.0;
            picture.row_mut(y)[left + x] = color(value);
        }
    }
    for step in 0..=4 {
        let value = limit * (f64::from(step) / 2.0 - 1.0);
        let sign = if value > 0.0 { "+" } else { "" };
        let label = format!("{sign}{value}");
        let x = left + bar * step as usize / 4;
        let (wide, _) = text_size(&label, 2);
        let from = x.saturating_sub(wide / 2) as isize;
        draw_text(picture, (from, top as isize + 24), 2, INK, &label);
    }
    let words = "mm from the other surface: red outside, blue inside";
    let at = ((left + bar + 40) as isize, top as isize + 2);
    draw_text(picture, at, 2, INK, words);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn what_is_outside_is_red_and_what_is_inside_blue() {
        let (small, large) = (shapes::sphere(0.03, 4), shapes::sphere(0.034, 4));
        let (outside, inside) = (
            vertex_distances(&large, &small),
            vertex_distances(&small, &large),
        );
        let rows = [
            Row {
                title: "model",
                mesh: &large,
                signed_mm: &outside,
            },
            Row {
                title: "truth",
                mesh: &small,
                signed_mm: &inside,
            },
        ];
        assert_eq!(limit_mm(&rows), 5.0);
        let picture = draw("a ball", &rows);
        for column in 0..VIEWS {
            let x = MARGIN + column * VIEW + VIEW / 2;
            let [r, _, b] = picture[(x, 2 * MARGIN + VIEW / 2)];
            assert!(r > b + 60, "{r} {b}");
            let [r, _, b] = picture[(x, 3 * MARGIN + VIEW + VIEW / 2)];
            assert!(b > r + 60, "{r} {b}");
        }
    }

    #[test]
    fn a_vertex_of_no_triangle_makes_no_picture_smaller() {
        let ball = shapes::sphere(0.03, 2);
        let mut stray = ball.clone();
        stray.vertices.push(Point3::new(0.0, 0.0, 5.0));
        let sphere = |mesh: &Mesh| {
            enclosing_sphere(&[Row {
                title: "",
                mesh,
                signed_mm: &[],
            }])
        };
        assert_eq!(sphere(&stray), sphere(&ball));
    }

    #[test]
    fn colours_run_from_blue_over_grey_to_red() {
        assert_eq!(color(0.0), [222; 3]);
        assert_eq!(color(-7.0), [20, 50, 140]);
        assert_eq!(color(7.0), [165, 20, 30]);
        assert_eq!(color(f64::NAN), [0; 3]);
    }
}
