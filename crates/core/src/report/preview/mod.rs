//! One picture of a whole reconstruction, so that a person sees at a glance what happened: the verdict's reasons,
//! the model beside the photographs, the depth cameras' panels, and every silhouette with the model's outline. This
//! file has the layout; `header` writes what is above the panels, and `views`, `depth` and `outlines` draw these.

mod canvas;
mod depth;
mod header;
mod object;
mod outlines;
mod views;
mod window;

pub use header::stamp;
pub use object::{CaptureViews, preview_object};
pub use views::picture_of;

use super::coarse::coarse;
use super::measure::by_provenance;
use super::verdict::Verdict;
use crate::description::{Description, PROVENANCES};
use crate::image::{RgbImage, text_size};
use crate::level::Level;
use crate::mesh::{Mesh, bounding_box};
use crate::reconstruct::{Reconstruction, Scene};
use canvas::{EMPTY, INK, PALE, PAPER, fill, paste, write};
use depth::DepthPanels;
use header::Header;
use rayon::prelude::*;
use views::{ViewPanels, provenance_color};

/// Width of the sheet in pixels.
const WIDTH: usize = 1920;
/// Around the sheet.
const MARGIN: usize = 18;
/// Between panels.
const GAP: usize = 8;
/// Panels in a row.
const PANELS: usize = 6;
/// Size of a panel in pixels.
const PANEL: (usize, usize) = ((WIDTH - 2 * MARGIN - (PANELS - 1) * GAP) / PANELS, 286);
/// Height of a line of words, which are of scale 2.
const LINE: usize = 24;
/// Silhouettes in a row, and how many there are room for.
const OUTLINES_IN_ROW: usize = 12;
const OUTLINES: usize = 5 * OUTLINES_IN_ROW;
/// Depth cameras there is room for.
const DEPTH_ROWS: usize = 3;

/// The colour of a level.
fn level_color(level: Level) -> [u8; 3] {
    match level {
        Level::Green => [34, 168, 100],
        Level::Amber => [240, 165, 30],
        Level::Red => [222, 50, 60],
    }
}

/// Draws the sheet, with the data about the object beside the verdict. [`stamp`] adds the notes on the capture.
pub fn preview(
    scene: &Scene,
    made: &Reconstruction,
    verdict: &Verdict,
    about: &Description,
) -> RgbImage {
    let panels = Panels::draw(scene, made, verdict);
    let header = Header::new(verdict, about, size_words(made));
    let mut sheet = RgbImage::filled(WIDTH, header.height() + panels.height(), PAPER);
    let mut top = header.draw(&mut sheet);
    top = panels.place_views(&mut sheet, scene, top);
    top = legend(&mut sheet, made, top);
    top = panels.place_depths(&mut sheet, top);
    panels.place_outlines(&mut sheet, scene, top);
    sheet
}

/// All pictures of the sheet.
struct Panels {
    views: Vec<ViewPanels>,
    depths: Vec<DepthPanels>,
    outlines: Vec<RgbImage>,
    /// Cameras whose silhouettes do not fit on the sheet.
    left_out: usize,
}

impl Panels {
    fn draw(scene: &Scene, made: &Reconstruction, verdict: &Verdict) -> Self {
        let model = &made.model;
        let chosen = views::choose(scene, made);
        let view = |&i: &usize| views::draw(scene, &made.silhouettes[i], model, i, PANEL);
        let depths: Vec<_> = scene
            .depths
            .iter()
            .zip(&made.depths)
            .take(DEPTH_ROWS)
            .collect();
        let shown = scene.colors.len().min(OUTLINES);
        let size = outline_size(shown);
        let outline = |coarse: &Mesh| {
            let each = scene.colors[..shown].par_iter().zip(&made.silhouettes);
            each.map(|(view, silhouette)| {
                let alarm = alarm(verdict, view);
                outlines::draw(view, silhouette, coarse, size, alarm)
            })
            .collect()
        };
        let (views, (depths, outlines)) = rayon::join(
            || chosen.par_iter().map(view).collect(),
            || {
                rayon::join(
                    || {
                        depths
                            .par_iter()
                            .map(|(v, r)| depth::draw(v, r, model, PANEL))
                            .collect()
                    },
                    || outline(&coarse(&model.mesh, coarse_cell(made, size))),
                )
            },
        );
        Self {
            views,
            depths,
            outlines,
            left_out: scene.colors.len() - shown,
        }
    }

    /// Height in pixels of all that lies below the header.
    fn height(&self) -> usize {
        let row = PANEL.1 + LINE + GAP;
        let view_rows = self.views.len().div_ceil(2);
        let per_row = outlines_in_row(self.outlines.len());
        let outline_rows = self.outlines.len().div_ceil(per_row);
        let outline_row = outline_size(self.outlines.len()).1 + LINE;
        (view_rows + self.depths.len()) * row
            + LINE
            + GAP
            + LINE
            + outline_rows * outline_row
            + MARGIN
    }

    /// Two cameras a row, three panels each.
    fn place_views(&self, sheet: &mut RgbImage, scene: &Scene, top: usize) -> usize {
        let mut below = top;
        for (index, view) in self.views.iter().enumerate() {
            let top = top + index / 2 * (PANEL.1 + LINE + GAP);
            let name = &scene.colors[view.camera].camera.id;
            let three = [
                (format!("photograph of {name}"), &view.photograph),
                ("the model from there".to_owned(), &view.model),
                ("where it comes from".to_owned(), &view.provenance),
            ];
            for (column, (caption, picture)) in three.into_iter().enumerate() {
                place(sheet, 3 * (index % 2) + column, top, &caption, picture);
            }
            below = top + PANEL.1 + LINE + GAP;
        }
        below
    }

    fn place_depths(&self, sheet: &mut RgbImage, top: usize) -> usize {
        let mut top = top;
        for panels in &self.depths {
            for (column, (caption, picture)) in panels.iter().enumerate() {
                place(sheet, column, top, caption, picture);
            }
            top += PANEL.1 + LINE + GAP;
        }
        top
    }

    fn place_outlines(&self, sheet: &mut RgbImage, scene: &Scene, top: usize) {
        let mut words = "silhouettes (grey) and the model's outline (yellow); red: silhouette \
                         without model, blue: model without silhouette"
            .to_owned();
        if self.left_out > 0 {
            words += &format!("; {} more cameras", self.left_out);
        }
        write(sheet, (MARGIN, top), 2, PALE, (WIDTH - 2 * MARGIN, &words));
        let per_row = outlines_in_row(self.outlines.len());
        let (width, height) = outline_size(self.outlines.len());
        for (index, picture) in self.outlines.iter().enumerate() {
            let left = MARGIN + index % per_row * (width + GAP);
            let top = top + LINE + index / per_row * (height + LINE);
            let name = scene.colors[index].camera.id.as_str();
            paste(sheet, picture, (left, top));
            write(
                sheet,
                (left + 6, top + height - 20),
                2,
                INK,
                (width - 8, name),
            );
        }
    }
}

/// One panel with its caption below.
fn place(sheet: &mut RgbImage, column: usize, top: usize, caption: &str, picture: &RgbImage) {
    let left = MARGIN + column * (PANEL.0 + GAP);
    paste(sheet, picture, (left, top));
    write(
        sheet,
        (left, top + PANEL.1 + 5),
        2,
        PALE,
        (PANEL.0, caption),
    );
}

/// Silhouettes of a row: few are shown larger.
fn outlines_in_row(count: usize) -> usize {
    count.clamp(PANELS, OUTLINES_IN_ROW)
}

fn outline_size(count: usize) -> (usize, usize) {
    let per_row = outlines_in_row(count);
    let width = (WIDTH - 2 * MARGIN - (per_row - 1) * GAP) / per_row;
    (width, width.min(200))
}

/// Edge of a cell that is about a pixel of the outlines.
fn coarse_cell(made: &Reconstruction, (width, _): (usize, usize)) -> f32 {
    let corners = bounding_box(&made.model.mesh.vertices).unwrap_or_default();
    let diagonal = nalgebra::distance(&corners[0], &corners[1]);
    (diagonal / width as f32).max(2.0 * made.cell_size as f32)
}

/// The colour that a camera is marked with: that of the gravest reason about it.
fn alarm(verdict: &Verdict, view: &crate::reconstruct::ColorView) -> Option<[u8; 3]> {
    let about = |reason: &&super::Reason| {
        reason.level > Level::Green && reason.cameras.contains(&view.camera.id)
    };
    let level = verdict.reasons.iter().filter(about).map(|r| r.level).max();
    level.map(level_color)
}

/// The model's size, in millimetres and in vertices.
fn size_words(made: &Reconstruction) -> String {
    let mesh = &made.model.mesh;
    let [low, high] = bounding_box(&mesh.vertices).unwrap_or_default();
    let [x, y, z]: [f32; 3] = (1e3 * (high - low)).into();
    format!(
        "{x:.0} x {y:.0} x {z:.0} mm, {} vertices",
        mesh.vertices.len()
    )
}

/// What the colours of the third panels mean, and how much of the model is of each.
fn legend(sheet: &mut RgbImage, made: &Reconstruction, top: usize) -> usize {
    let mut left = MARGIN;
    for part in by_provenance(&made.model) {
        let (_, words) = PROVENANCES[part.provenance as usize];
        let label = format!("{words} {:.0} %", 100.0 * part.share);
        let (color, ink) = if part.share > 0.0 {
            (provenance_color(part.provenance), INK)
        } else {
            (EMPTY, PALE)
        };
        fill(sheet, (left, top), (16, 16), color);
        let wide = text_size(&label, 2).0 + 12;
        write(sheet, (left + 24, top), 2, ink, (wide, &label));
        left += 24 + wide + 24;
    }
    top + LINE + GAP
}
