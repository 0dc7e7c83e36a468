//! The sheet of an object that was fused of several captures: that of a single one, with the underside and a column a
//! capture below.

use super::canvas::{EMPTY, PALE, PAPER, paste, write};
use super::views::{self, in_color};
use super::{GAP, LINE, MARGIN, PANEL, PANELS, Verdict, WIDTH, place, preview};
use crate::description::Description;
use crate::image::RgbImage;
use crate::mesh::{Drawn, bounding_box, parallel_view};
use crate::reconstruct::{Model, Reconstruction, Scene};
use nalgebra::{Vector3, center, distance};
use rayon::prelude::*;
use std::ops::Range;

/// A capture's name and the numbers of its colour views in the scene.
pub type CaptureViews = (String, Range<usize>);

/// Two pictures, one above the other, with their captions.
type Column = [(String, RgbImage); 2];

/// Draws the sheet of an object.
pub fn preview_object(
    scene: &Scene,
    made: &Reconstruction,
    verdict: &Verdict,
    about: &Description,
    captures: &[CaptureViews],
) -> RgbImage {
    let above = preview(scene, made, verdict, about);
    let mut columns = vec![from_outside(&made.model)];
    let drawn = captures.par_iter();
    columns.par_extend(drawn.filter_map(|capture| column(scene, made, capture)));
    let row = PANEL.1 + LINE + GAP;
    let rows = 2 * columns.len().div_ceil(PANELS);
    let height = above.height() + LINE + rows * row + MARGIN;
    let mut sheet = RgbImage::filled(WIDTH, height, PAPER);
    paste(&mut sheet, &above, (0, 0));
    let words = "the underside, and for each capture a photograph and the model from there";
    let top = above.height();
    write(
        &mut sheet,
        (MARGIN, top),
        2,
        PALE,
        (WIDTH - 2 * MARGIN, words),
    );
    for (index, column) in columns.iter().enumerate() {
        for (line, (caption, picture)) in column.iter().enumerate() {
            let top = top + LINE + (2 * (index / PANELS) + line) * row;
            place(&mut sheet, index % PANELS, top, caption, picture);
        }
    }
    sheet
}

/// A capture's camera whose silhouette is largest among those that the frame does not cut.
fn column(scene: &Scene, made: &Reconstruction, (name, cameras): &CaptureViews) -> Option<Column> {
    let rating = |&i: &usize| {
        let facts = &made.silhouettes[i].facts;
        (
            facts.edge_px == [0; 4],
            facts.area_px as u64,
            std::cmp::Reverse(i),
        )
    };
    let camera = cameras.clone().max_by_key(rating)?;
    let panels = views::draw(scene, &made.silhouettes[camera], &made.model, camera, PANEL);
    let id = &scene.colors[camera].camera.id;
    Some([
        (format!("{name}, {id}"), panels.photograph),
        ("the model from there".to_owned(), panels.model),
    ])
}

/// The model from below and from above.
fn from_outside(model: &Model) -> Column {
    let [low, high] = bounding_box(&model.mesh.vertices).unwrap_or_default();
    let from = |towards_eye: Vector3<f32>| {
        let radius = 0.5 * distance(&low, &high);
        let view = parallel_view(center(&low, &high), radius, towards_eye, PANEL);
        if model.mesh.triangles.is_empty() {
            return RgbImage::filled(PANEL.0, PANEL.1, EMPTY);
        }
        in_color(model, &Drawn::closed(&model.mesh, &view, 2))
    };
    [
        ("the model from below".to_owned(), from(-Vector3::z())),
        ("the model from above".to_owned(), from(Vector3::z())),
    ]
}
