//! The results as lines for a terminal.

use super::figures::{Figures, Part, RimFigures};
use super::{Evaluation, Expected, Solid, Summary};
use std::fmt::Write;

/// All figures of an evaluation in words and columns.
pub fn table(found: &Evaluation) -> String {
    let mut out = String::new();
    solid(&mut out, "model", &found.model);
    solid(&mut out, "truth", &found.truth);
    line(
        &mut out,
        &format!("volume {:+.2} %", found.volume_error_percent),
    );
    figures(&mut out, &found.whole);
    if !found.by_provenance.is_empty() {
        by_provenance(&mut out, found);
        truth_of_expected(&mut out, found);
    }
    if !found.by_expected_error.is_empty() {
        by_expected_error(&mut out, found);
    }
    out
}

/// Writing to a string cannot fail.
fn line(out: &mut String, text: &str) {
    out.push_str(text.trim_end());
    out.push('\n');
}

/// One line on a mesh as a solid.
pub fn solid(out: &mut String, name: &str, solid: &Solid) {
    let tight = if solid.watertight {
        "watertight"
    } else {
        "NOT watertight"
    };
    let genus = solid
        .genus
        .map_or("no genus".to_owned(), |g| format!("genus {g}"));
    line(
        out,
        &format!(
            "{name:8} {} vertices, {} triangles, {tight}, components {}, {genus}, {:.2} cm³, {:.2} cm²",
            solid.vertices, solid.triangles, solid.components, solid.volume_cm3, solid.area_cm2
        ),
    );
}

/// The head of a table of summaries.
pub fn summary_head(out: &mut String) {
    line(
        out,
        &format!(
            "\n{:24}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}",
            "mm", "samples", "mean", "median", "p90", "p99", "max"
        ),
    );
}

/// A line of a table of summaries; none of nothing.
pub fn summary(out: &mut String, name: &str, summary: Option<Summary>) {
    if let Some(s) = summary {
        line(
            out,
            &format!(
                "{name:24}{:>9}{:>9.3}{:>9.3}{:>9.3}{:>9.3}{:>9.3}",
                s.samples, s.mean_mm, s.median_mm, s.p90_mm, s.p99_mm, s.max_mm
            ),
        );
    }
}

fn figures(out: &mut String, found: &Figures) {
    summary_head(out);
    summary(out, "accuracy", found.accuracy);
    summary(out, "completeness", found.completeness);
    if let Some(Part { share, distances }) = found.concave {
        let name = format!("concave part ({:.1} %)", 100.0 * share);
        summary(out, &name, Some(distances));
    }
    if let Some(Part { share, distances }) = found.edges {
        let name = format!("sharp edges ({:.1} %)", 100.0 * share);
        summary(out, &name, Some(distances));
    }
    if let Some(RimFigures {
        accuracy,
        completeness,
    }) = found.rims
    {
        summary(out, "rims, accuracy", accuracy);
        summary(out, "rims, completeness", completeness);
    }
    if let Some(walls) = found.walls {
        summary(out, "thickness of walls", walls.error);
        let bias = walls
            .bias_mm
            .map_or(String::new(), |b| format!(", bias {b:+.3} mm"));
        line(
            out,
            &format!(
                "  walls: {:.1} % of the truth, {:.2} mm thick, lost {:.1} %{bias}",
                100.0 * walls.share,
                walls.truth_mean_mm,
                100.0 * walls.lost_share
            ),
        );
    }
    line(out, "");
    for f in &found.f_scores {
        line(
            out,
            &format!(
                "F-score at {} mm: {:.4} (precision {:.4}, recall {:.4})",
                f.threshold_mm, f.f_score, f.precision, f.recall
            ),
        );
    }
    if let Some(bias) = found.bias {
        line(
            out,
            &format!(
                "signed bias: mean {:+.3} mm, median {:+.3} mm",
                bias.mean_mm, bias.median_mm
            ),
        );
    }
    if let Some(normals) = found.normals {
        line(
            out,
            &format!(
                "normals: mean {:.1}°, median {:.1}°, p90 {:.1}°",
                normals.mean_degrees, normals.median_degrees, normals.p90_degrees
            ),
        );
    }
    if let Some(normals) = found.outside_normals {
        line(
            out,
            &format!(
                "normals of the outside, without its edges: mean {:.1}°, median {:.1}°, p90 {:.1}°",
                normals.mean_degrees, normals.median_degrees, normals.p90_degrees
            ),
        );
    }
    line(
        out,
        &format!(
            "dented: {:.2} % of the truth stand out of the model by more than 0.3 mm",
            100.0 * found.dented_share
        ),
    );
}

/// A number in a column of nine, or a dash.
fn cell(value: Option<f64>) -> String {
    value.map_or(format!("{:>9}", "-"), |v| format!("{v:>9.3}"))
}

fn by_provenance(out: &mut String, found: &Evaluation) {
    let mut head = format!("\n{:10}", "mm, by");
    for name in [
        "share",
        "accuracy",
        "complete",
        "F at 1",
        "bias",
        "rims",
        "walls",
        "normals°",
        "expected",
    ] {
        let _ = write!(head, "{name:>10}");
    }
    line(out, &head);
    for part in &found.by_provenance {
        let f = &part.figures;
        let rims = f.rims.and_then(|r| r.accuracy);
        let columns = [
            Some(part.share),
            f.accuracy.map(|s| s.mean_mm),
            f.completeness.map(|s| s.mean_mm),
            f.f_score_at(1.0),
            f.bias.map(|b| b.mean_mm),
            rims.map(|s| s.mean_mm),
            f.walls.and_then(|w| w.error).map(|s| s.mean_mm),
            f.normals.map(|n| n.mean_degrees),
            f.expected.map(|e| e.expected_mean_mm),
        ];
        let name = part.provenance.name();
        let cells: String = columns
            .into_iter()
            .map(|c| format!(" {}", cell(c)))
            .collect();
        line(out, &format!("{name:10}{cells}"));
    }
}

/// Whether the expected errors are true, of the whole model and of each provenance.
fn truth_of_expected(out: &mut String, found: &Evaluation) {
    let parts = found
        .by_provenance
        .iter()
        .map(|part| (part.provenance.name(), part.figures.expected));
    let whole = [("whole", found.whole.expected)];
    let stating: Vec<(&str, Expected)> = whole
        .into_iter()
        .chain(parts)
        .filter_map(|(name, expected)| Some((name, expected?)))
        .collect();
    if stating.is_empty() {
        return;
    }
    let mut head = format!("\n{:16}", "expected errors");
    for name in [
        "samples",
        "expected",
        "actual",
        "ratio",
        "within",
        "within 2x",
        "beyond 3x",
        "rank",
        "p90/p10",
    ] {
        let _ = write!(head, "{name:>10}");
    }
    line(out, &head);
    for (name, e) in stating {
        let columns = [
            Some(e.expected_mean_mm),
            Some(e.actual_mean_mm),
            e.actual_over_expected,
            Some(e.within_share),
            Some(e.within_twice_share),
            Some(e.beyond_thrice_share),
            e.rank_correlation,
            e.actual_spread,
        ];
        let cells: String = columns
            .into_iter()
            .map(|c| format!(" {}", cell(c)))
            .collect();
        line(out, &format!("{name:16}{:>10}{cells}", e.samples));
    }
}

fn by_expected_error(out: &mut String, found: &Evaluation) {
    let mut head = format!("\n{:16}", "expected, mm");
    for name in [
        "samples",
        "expected",
        "actual",
        "median",
        "p90",
        "within",
        "within 2x",
    ] {
        let _ = write!(head, "{name:>10}");
    }
    line(out, &head);
    for bin in &found.by_expected_error {
        let range = match bin.to_mm {
            Some(to) => format!("{} to {to}", bin.from_mm),
            None => format!("{} and more", bin.from_mm),
        };
        let e = &bin.expected;
        let columns = [
            e.expected_mean_mm,
            e.actual_mean_mm,
            e.actual_median_mm,
            e.actual_p90_mm,
            e.within_share,
            e.within_twice_share,
        ];
        let cells: String = columns
            .iter()
            .map(|&c| format!(" {}", cell(Some(c))))
            .collect();
        line(out, &format!("{range:16}{:>10}{cells}", e.samples));
    }
}
