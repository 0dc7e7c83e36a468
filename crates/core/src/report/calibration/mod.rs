//! A calibration's report: one self-contained HTML page with its pictures, for the person who has to decide what to
//! do. This room makes the text; a command writes the file.

mod advice;
mod cameras;
mod depth;
mod html;
mod placements;
mod rig;
mod uncertainty;
mod unseen;
mod views;

pub use views::{Found, ViewPicture};

use crate::calibration::CalibrationLevel;
use crate::calibration::fit::{Fit, Judgement, Limits, ReasonKind};
use crate::calibration::response::PlaneFit;
use crate::frame::CameraId;
use crate::markup::escaped;
use crate::words::count;
use advice::advice;
use html::style;
use std::collections::BTreeMap;
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
    /// The session's placements, in their order.
    pub placements: &'a [String],
    /// Pictures without a board that could be used: camera, placement and why.
    pub rejected: &'a [(CameraId, String, String)],
    /// Pictures to look at.
    pub pictures: &'a [ViewPicture],
    /// What could not be read.
    pub lost: &'a [String],
    /// What else a person should know of the pictures.
    pub warnings: &'a [String],
    /// What the depth cameras' readings mean.
    pub depths: &'a [(CameraId, &'a PlaneFit)],
    /// What else there is to say of depth.
    pub depth_words: &'a [String],
    /// What sets the scale, and what witnesses say of it.
    pub scale: &'a [String],
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
    scale(&mut html, page);
    unseen::section(&mut html, page);
    placements::plot(&mut html, page);
    cameras::table(&mut html, page);
    cameras::pictures(&mut html, fit);
    uncertainty::maps(&mut html, fit);
    views::section(&mut html, page);
    no_board(&mut html, page);
    rig::top_view(&mut html, fit);
    rig::graph(&mut html, fit);
    placements::table(&mut html, page);
    depth::section(&mut html, page);
    html += "</body></html>\n";
    html
}

/// Residual in pixels whose arrow is drawn as a scale.
const ARROW_PX: f64 = 0.25;

/// The style of a level.
fn style_of(level: CalibrationLevel) -> &'static str {
    match level {
        CalibrationLevel::Good => "good",
        CalibrationLevel::Accepted => "fair",
        CalibrationLevel::Doubtful => "poor",
        CalibrationLevel::Refused => "bad",
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
        "<h1>Calibration: <span class=\"{class}\">{word}</span></h1>\n<p>{}, {} of <code>{}</code>, {} \
         corners, from {}.</p>\n<p class=\"figures\">",
        count(fit.cameras.len(), "camera"),
        count(fit.placements.len(), "placement"),
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
    figure(
        "",
        page.rejected.len().to_string(),
        "pictures without a board",
    );
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
    if let Some(at_object) = fit.at_object() {
        let words =
            "one standard deviation of what is seen of the object, across the line of sight";
        figure("", format!("{:.3} mm", 1e3 * at_object), words);
    }
    for (id, depth) in page.depths {
        let value = match depth.response.has_known_uncertainty() {
            true => format!("{:.2} mm", 1e3 * depth.response.uncertainty),
            false => "unknown".to_owned(),
        };
        figure("", value, &format!("bias of {id}'s depth at most"));
    }
    *html += "</p>\n";
}

/// What is red, and what to do about it.
fn to_do(html: &mut String, page: &CalibrationPage<'_>) {
    let reasons = &page.judgement.reasons;
    let left_out = left_out_words(page);
    let notes = [page.missing, page.lost, page.warnings].concat();
    if reasons.is_empty() && notes.is_empty() && left_out.is_none() {
        *html += "<h2>What to do</h2><p>Nothing: keep the file, and check the rig against it each day.</p>\n";
        return;
    }
    *html += "<h2>What to do</h2>\n<ul>";
    for reason in reasons {
        let _ = write!(
            html,
            "<li>{}. {}</li>",
            escaped(&reason.words),
            advice(reason.kind)
        );
    }
    if let Some(words) = left_out {
        let _ = write!(html, "<li>{words}</li>");
    }
    for lost in page.lost {
        let _ = write!(html, "<li>Not read: {}</li>", escaped(lost));
    }
    for warning in page.warnings {
        let _ = write!(html, "<li>Note: {}</li>", escaped(warning));
    }
    *html += "</ul>\n";
    missing(html, page);
}

/// That some views were left out, where that is too few for a reason of the verdict.
fn left_out_words(page: &CalibrationPage<'_>) -> Option<String> {
    let share = page.fit.left_out_share();
    let mut reasons = page.judgement.reasons.iter();
    let is_said = reasons.any(|reason| reason.kind == ReasonKind::LeftOut);
    (share.left_out > 0 && !is_said).then(|| {
        format!(
            "{} of {} views of the board ({:.0} %) were left out: see below what they are, and why. If it is not a blurred \
             picture or a board that moved, correct what caused it, and show the board again.",
            share.left_out,
            share.read,
            (100.0 * share.part()).max(1.0)
        )
    })
}

/// What the session lacks, as a table of whom and what.
fn missing(html: &mut String, page: &CalibrationPage<'_>) {
    if page.missing.is_empty() {
        return;
    }
    *html += "<p>Show the board once more, and calibrate from both sessions together:</p>\n<table class=\"words\">\
              <tr><th>what</th><th>what it lacks</th></tr>\n";
    for missing in page.missing {
        let (whom, what) = missing.split_once(": ").unwrap_or(("", missing));
        let _ = writeln!(
            html,
            "<tr><td>{}</td><td>{}</td></tr>",
            escaped(whom),
            escaped(what)
        );
    }
    *html += "</table>\n";
}

/// Why pictures show no board that could be used, and how many of each camera.
fn no_board(html: &mut String, page: &CalibrationPage<'_>) {
    if page.rejected.is_empty() {
        return;
    }
    let mut counts: BTreeMap<(&CameraId, &str), usize> = BTreeMap::new();
    for (camera, _, why) in page.rejected {
        *counts.entry((camera, why.as_str())).or_default() += 1;
    }
    *html += "<h2>Pictures without a board that could be used</h2>\n<table class=\"words\"><tr><th>camera</th>\
              <th>pictures</th><th>why</th></tr>\n";
    for ((camera, why), count) in counts {
        let _ = writeln!(
            html,
            "<tr><td>{}</td><td>{count}</td><td>{}</td></tr>",
            escaped(camera.as_str()),
            escaped(why)
        );
    }
    *html += "</table>\n";
}

/// What sets the scale of all lengths, and what witnesses say of it.
fn scale(html: &mut String, page: &CalibrationPage<'_>) {
    *html += "<h2>Scale</h2>\n<ul>";
    for words in page.scale {
        let words = words.strip_prefix("scale: ").unwrap_or(words);
        let _ = write!(html, "<li>{}.</li>", escaped(words));
    }
    *html += "</ul>\n";
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
