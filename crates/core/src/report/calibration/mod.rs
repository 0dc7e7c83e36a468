//! A calibration's report: one HTML page that needs nothing else, with its pictures in it, for the person who has to
//! decide what to do. It makes text; a command makes a file of it.

mod cameras;
mod depth;
mod html;
mod rig;

use crate::calibration::Level;
use crate::calibration::fit::{Fit, Judgement, Limits};
use crate::calibration::response::PlaneFit;
use crate::frame::CameraId;
use html::{escaped, style};
use std::fmt::Write;

/// All that a page tells.
#[derive(Clone, Copy, Debug)]
pub struct CalibrationPage<'a> {
    /// What was fitted.
    pub fit: &'a Fit,
    /// What it is worth.
    pub judgement: &'a Judgement,
    /// When a figure is red.
    pub limits: &'a Limits,
    /// What the session lacks, in words.
    pub missing: &'a [String],
    /// Pictures in which no board was found that could be used.
    pub unread: usize,
    /// What could not be read.
    pub lost: &'a [String],
    /// What the depth cameras' readings mean.
    pub depths: &'a [(CameraId, &'a PlaneFit)],
    /// What else there is to say of depth.
    pub depth_words: &'a [String],
    /// Where it comes from: names of the recordings.
    pub sources: &'a [String],
}

/// The page.
pub fn calibration_page(page: &CalibrationPage<'_>) -> String {
    let mut html = String::new();
    let fit = page.fit;
    let _ = write!(
        html,
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width\">\n<title>Calibration: {}</title>\n<style>{}</style></head><body>\n",
        page.judgement.level.name(),
        style(),
    );
    heading(&mut html, page);
    to_do(&mut html, page);
    left_out(&mut html, page);
    cameras::table(&mut html, page);
    cameras::pictures(&mut html, fit);
    rig::top_view(&mut html, fit);
    rig::graph(&mut html, fit);
    placements(&mut html, page);
    depth::section(&mut html, page);
    html += "</body></html>\n";
    html
}

/// The style of a level.
fn style_of(level: Level) -> &'static str {
    match level {
        Level::Good => "good",
        Level::Accepted => "fair",
        Level::Doubtful => "poor",
        Level::Refused => "bad",
    }
}

/// The style of a share of views that were left out.
fn by_left_out(part: f64, limits: &Limits) -> &'static str {
    match part {
        p if p > limits.left_out_refused => "bad",
        p if p > limits.left_out_doubtful => "poor",
        p if p > 0.0 => "fair",
        _ => "good",
    }
}

/// The style of a root mean square residual.
fn by_rms(rms: f64, limits: &Limits) -> &'static str {
    match rms {
        r if r <= limits.good_px => "good",
        r if r <= limits.accepted_px => "fair",
        r if r <= limits.refused_px => "poor",
        _ => "bad",
    }
}

fn heading(html: &mut String, page: &CalibrationPage<'_>) {
    let fit = page.fit;
    let level = page.judgement.level;
    let (class, word) = (style_of(level), level.name());
    let _ = write!(
        html,
        "<h1>Calibration: <span class=\"{class}\">{word}</span></h1>\n<p>{} cameras, {} placements of <code>{}</code>, \
         {} corners, from {}.</p>\n<p class=\"figures\">",
        fit.cameras.len(),
        fit.placements.len(),
        escaped(&fit.board.to_string()),
        fit.figures.corners,
        escaped(&page.sources.join(", ")),
    );
    let mut figure = |class: &str, value: String, what: &str| {
        let _ = write!(
            html,
            "<span class=\"figure {class}\"><b>{value}</b> {what}</span> "
        );
    };
    let share = fit.left_out_share();
    figure(
        by_left_out(share.part(), page.limits),
        format!("{} of {}", share.left_out, share.read),
        "views left out",
    );
    figure("", page.unread.to_string(), "pictures without a board");
    let dropped: usize = fit.cameras.iter().map(|c| c.false_corners).sum();
    let read = dropped + fit.figures.corners;
    figure("", format!("{dropped} of {read}"), "corners dropped");
    let figures = &fit.figures;
    figure(
        by_rms(figures.rms_px, page.limits),
        format!("{:.3} px", figures.rms_px),
        "rms",
    );
    figure("", format!("{:.3} px", figures.median_px), "median");
    figure("", format!("{:.2} px", figures.max_px), "largest");
    if let Some(held_out) = &fit.held_out {
        let fine = held_out.ratio <= page.limits.held_out_ratio;
        let words = format!(
            "on placements held out, {:.2} times ({} fits)",
            held_out.ratio, held_out.folds
        );
        let value = format!("{:.3} px", held_out.figures.rms_px);
        figure(if fine { "good" } else { "poor" }, value, &words);
    }
    for (id, depth) in page.depths {
        let value = format!("{:.2} mm", 1e3 * depth.response.uncertainty);
        figure("", value, &format!("bias of {id}'s depth at most"));
    }
    *html += "</p>\n";
}

/// What is red, and what to do about it.
fn to_do(html: &mut String, page: &CalibrationPage<'_>) {
    let reasons = &page.judgement.reasons;
    if reasons.is_empty() && page.missing.is_empty() && page.lost.is_empty() {
        *html += "<h2>What to do</h2><p>Nothing: keep the file, and check the rig against it each day.</p>\n";
        return;
    }
    *html += "<h2>What to do</h2>\n<ul>";
    for reason in reasons {
        let _ = write!(html, "<li>{}. {}</li>", escaped(reason), advice(reason));
    }
    for missing in page.missing {
        let _ = write!(
            html,
            "<li class=\"missing\">Show the board once more: {}</li>",
            escaped(missing)
        );
    }
    for lost in page.lost {
        let _ = write!(html, "<li>Not read: {}</li>", escaped(lost));
    }
    *html += "</ul>\n";
}

/// What helps against a reason.
fn advice(reason: &str) -> &'static str {
    // By the words of the judgement: they are for people, and so is this.
    let advice = [
        (
            "were left out",
            "See what was left out, and why, below. A camera that moved or was refocused, exchanged cables, or pictures of \
             another moment do this: mend it, and show the board again.",
        ),
        ("at one place", "Check the cameras' cables and names."),
        (
            "were dropped",
            "Check that the board is flat and evenly lit, and its picture sharp.",
        ),
        (
            "held out",
            "Add placements in other tilts and places; check that the board is flat and no lens moves.",
        ),
        (
            "has no response",
            "Show it the board more often, tilted, from the nearest to the farthest distance that matters.",
        ),
        (
            "a bias of",
            "Show it the board at more distances; check that the board is flat and its picture sharp.",
        ),
        (
            "is not calibrated",
            "Show it the board together with a neighbour, three times or more.",
        ),
        (
            "views, expected",
            "Show it the board more often, in different tilts.",
        ),
        (
            "of its picture, expected",
            "Hold the board into the corners of its picture too.",
        ),
        (
            "lies flat",
            "Put the board flat on the table once, or name the placement with --table-placement.",
        ),
        (
            "rms",
            "Look at its arrows below: one direction means that it moved, a whirl or a star another lens model \
          (--model rational), noise everywhere blur, poor light or a board that is not flat.",
        ),
    ];
    let found = advice.into_iter().find(|(words, _)| reason.contains(words));
    found.map_or("", |(_, advice)| advice)
}

fn placements(html: &mut String, page: &CalibrationPage<'_>) {
    *html += "<h2>Placements</h2>\n<table><tr><th>placement</th><th>cameras</th><th>corners</th><th>rms px</th>\
              <th>median</th><th>largest</th><th>middle, m</th></tr>\n";
    for placement in &page.fit.placements {
        let f = &placement.figures;
        let board = &page.fit.board;
        let first = board.corner_position(0, 0);
        let last = board.corner_position(board.columns - 1, board.rows - 1);
        let middle = placement.rig_from_board * nalgebra::center(&first, &last);
        let is_table = if placement.name == page.fit.table {
            " (table)"
        } else {
            ""
        };
        let _ = writeln!(
            html,
            "<tr><td>{}{is_table}</td><td>{}</td><td>{}</td><td class=\"{}\">{:.3}</td><td>{:.3}</td><td>{:.2}</td>\
             <td>{:.3}, {:.3}, {:.3}</td></tr>",
            escaped(&placement.name),
            placement.cameras,
            f.corners,
            by_rms(f.rms_px, page.limits),
            f.rms_px,
            f.median_px,
            f.max_px,
            middle.x,
            middle.y,
            middle.z,
        );
    }
    *html += "</table>\n";
}

fn left_out(html: &mut String, page: &CalibrationPage<'_>) {
    if page.fit.left_out.is_empty() {
        return;
    }
    *html += "<h2>Left out</h2>\n<ul>";
    for left_out in &page.fit.left_out {
        let _ = write!(
            html,
            "<li>{}: {}</li>",
            escaped(&left_out.subject()),
            escaped(&left_out.reason)
        );
    }
    *html += "</ul>\n";
}

#[cfg(test)]
mod tests;
