//! Pictures with what was found in them: the worst views, those that were left out, and pictures in which no board was
//! found that could be used.

use super::html::base64;
use super::{ARROW_PX, CalibrationPage};
use crate::frame::CameraId;
use crate::markup::escaped;
use nalgebra::{Point2, Vector2};
use std::fmt::Write;

/// Width of a picture on the page, in its pixels.
const WIDTH: f64 = 400.0;
/// Length on the page of an arrow for a residual of [`ARROW_PX`], and of the longest.
const ARROW: f64 = 25.0;
const LONGEST_ARROW: f64 = 60.0;

/// What became of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// The fit used its view of the board.
    Used,
    /// The fit threw its view out.
    LeftOut,
    /// No board was found in it that could be used.
    Nothing,
}

/// A picture to look at.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewPicture {
    /// The camera.
    pub camera: CameraId,
    /// The placement.
    pub placement: String,
    /// What became of it.
    pub found: Found,
    /// Its residual, or why it was not used.
    pub words: String,
    /// The picture as a JPEG file, smaller than it was.
    pub jpeg: Vec<u8>,
    /// Width and height that it had, in pixels.
    pub size: [usize; 2],
    /// Where corners were found, in pixels of the whole picture; with where they are predicted less that, if they are.
    pub corners: Vec<(Point2<f64>, Option<Vector2<f64>>)>,
}

/// The pictures, by what became of them.
pub(super) fn section(html: &mut String, page: &CalibrationPage<'_>) {
    if page.pictures.is_empty() {
        return;
    }
    let _ = write!(
        html,
        "<h2>Pictures to look at</h2>\n<p>Green: where corners were found. Red: from there to where they are predicted; an \
         arrow as long as the one below a picture is {ARROW_PX} px.</p>\n"
    );
    for (found, heading) in [
        (Found::LeftOut, "Views that were left out"),
        (
            Found::Nothing,
            "Pictures in which no board was found that can be used",
        ),
        (Found::Used, "The worst views of those that were used"),
    ] {
        let mut of_kind = page.pictures.iter().filter(|p| p.found == found).peekable();
        if of_kind.peek().is_none() {
            continue;
        }
        let _ = write!(html, "<h3>{heading}</h3>\n<div class=\"pictures\">");
        of_kind.for_each(|picture| figure(html, picture));
        *html += "</div>\n";
    }
}

fn figure(html: &mut String, picture: &ViewPicture) {
    let [width, height] = picture.size.map(|side| side.max(1) as f64);
    let scale = WIDTH / width;
    let shown = height * scale;
    let _ = write!(
        html,
        "<figure><svg width=\"{WIDTH}\" height=\"{0:.0}\" viewBox=\"0 0 {WIDTH} {0:.1}\"><image width=\"{WIDTH}\" \
         height=\"{shown:.1}\" preserveAspectRatio=\"none\" href=\"data:image/jpeg;base64,{1}\"/>",
        shown + 18.0,
        base64(&picture.jpeg)
    );
    let (mut dots, mut arrows) = (String::new(), String::new());
    for (pixel, residual) in &picture.corners {
        let (x, y) = ((pixel.x + 0.5) * scale, (pixel.y + 0.5) * scale);
        let _ = write!(dots, "M{:.1} {y:.1}h4M{x:.1} {:.1}v4", x - 2.0, y - 2.0);
        if let Some(residual) = residual {
            let arrow = residual * (ARROW / ARROW_PX);
            let arrow = arrow.cap_magnitude(LONGEST_ARROW);
            let _ = write!(arrows, "M{x:.1} {y:.1}l{:.1} {:.1}", arrow.x, arrow.y);
        }
    }
    let y = shown + 9.0;
    let _ = write!(
        html,
        "<path d=\"{dots}\" stroke=\"#1fbf4a\" stroke-width=\"1\" fill=\"none\"/><path d=\"{arrows}\" stroke=\"#e02020\" \
         stroke-width=\"1.3\" fill=\"none\"/>"
    );
    if !arrows.is_empty() {
        let _ = write!(
            html,
            "<path d=\"M6 {y:.1}h{ARROW}\" stroke=\"#e02020\" stroke-width=\"1.3\"/><text x=\"{:.0}\" y=\"{:.1}\">{ARROW_PX} \
             px</text>",
            ARROW + 12.0,
            y + 4.0
        );
    }
    let _ = writeln!(
        html,
        "</svg><figcaption><b>{}, {}</b>: {}</figcaption></figure>",
        escaped(picture.camera.as_str()),
        escaped(&picture.placement),
        escaped(&picture.words)
    );
}
