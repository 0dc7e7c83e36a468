//! Tests that the page has the results of the fit, needs no other file, and escapes every text.

use super::*;
use crate::calibration::fit::{
    Figures, FittedCamera, FittedPlacement, FittedShape, HeldOut, LeftOut, Projection, Uncertainty,
    ViewResiduals, judge,
};
use crate::calibration::{Board, Camera, Distortion, Face, Intrinsics};
use nalgebra::{Isometry3, Point2, Vector2, Vector3};
use std::collections::BTreeMap;

fn camera(name: &str, x: f64, rms: f64) -> FittedCamera {
    let (focal, center) = (Vector2::repeat(600.0), Vector2::new(319.5, 239.5));
    let lens = Intrinsics::new(640, 480, focal, center, Distortion::default()).unwrap();
    let pose = Isometry3::new(Vector3::new(x, 0.0, 1.0), Vector3::x() * 3.0);
    FittedCamera {
        camera: Camera::new(CameraId::new(name).unwrap(), lens, pose),
        uncertainty: Uncertainty::default(),
        projection: None,
        figures: Figures {
            corners: 4,
            rms_px: rms,
            median_px: 0.1,
            max_px: 0.5,
        },
        views: 7,
        coverage: 0.5,
        false_corners: 0,
        is_lens_given: false,
    }
}

fn fit() -> Fit {
    let residual = (Point2::new(100.0, 50.0), Vector2::new(0.1, -0.2));
    let view = |camera| ViewResiduals {
        camera,
        placement: 0,
        face: Face::Front,
        corners: vec![residual],
    };
    let figures = Figures {
        corners: 8,
        rms_px: 0.31,
        median_px: 0.1,
        max_px: 0.5,
    };
    Fit {
        board: Board::checkerboard(9, 6, 0.025).unwrap(),
        cameras: vec![camera("c00", -0.5, 0.05), camera("c01", 0.5, 0.9)],
        placements: vec![FittedPlacement {
            name: "<script>alert(1)</script>".to_owned(),
            rig_from_board: Isometry3::identity(),
            figures,
            cameras: 2,
        }],
        front_from_back: Isometry3::identity(),
        shape: FittedShape::default(),
        table: "p".to_owned(),
        table_is_lowest: true,
        figures,
        held_out: Some(HeldOut {
            figures,
            ratio: 1.5,
            folds: 5,
        }),
        volume: None,
        changes: Vec::new(),
        left_out: vec![LeftOut {
            camera: None,
            placement: Some("p7".to_owned()),
            reason: "it moved".to_owned(),
            views: vec![CameraId::new("c00").unwrap()],
            apart: None,
        }],
        views: Vec::new(),
        residuals: vec![view(0), view(1)],
        links: vec![[0, 1]],
    }
}

/// The page of a fit, judged, that lacks nothing.
fn page_of(fit: &Fit) -> String {
    let limits = Limits::default();
    let judgement = judge(fit, &[], &BTreeMap::new(), &limits);
    calibration_page(&CalibrationPage {
        fit,
        judgement: &judgement,
        limits: &limits,
        missing: &[],
        placements: &["p6", "p7"].map(str::to_owned),
        rejected: &[],
        pictures: &[],
        lost: &[],
        warnings: &[],
        depths: &[],
        depth_words: &[],
        scale: &[],
        sources: &[],
    })
}

/// A fit that is good.
fn good_fit() -> Fit {
    let mut fit = fit();
    let one = fit.residuals[0].clone();
    fit.cameras[1].figures.rms_px = 0.05;
    fit.figures.rms_px = 0.05;
    let placement = fit.placements[0].clone();
    fit.placements = vec![placement; 5];
    fit.residuals = vec![one; 20];
    fit.left_out.clear();
    if let Some(held_out) = &mut fit.held_out {
        held_out.ratio = 1.0;
    }
    fit
}

#[test]
fn any_view_that_was_left_out_is_something_to_look_at() {
    let mut fit = good_fit();
    let nothing = "Nothing: keep the file";
    assert!(page_of(&fit).contains(nothing), "{}", page_of(&fit));
    fit.left_out.push(LeftOut {
        camera: Some(CameraId::new("c00").unwrap()),
        placement: Some("p7".to_owned()),
        reason: "it is blurred".to_owned(),
        views: vec![CameraId::new("c00").unwrap()],
        apart: None,
    });
    let page = page_of(&fit);
    assert!(page.contains("Calibration: <span class=\"good\">"));
    assert!(
        !page.contains(nothing)
            && page.contains("<li>1 of 21 views of the board (5 %) were left out: see below")
    );
}

#[test]
fn what_no_session_like_this_can_show_is_said() {
    let mut fit = good_fit();
    let all_mirrored = "If the pictures of all cameras are mirrored";
    assert!(page_of(&fit).contains(all_mirrored));
    let zoomed = "zoomed by 1 % between two pictures fits a lens in between";
    assert!(!page_of(&fit).contains(zoomed));
    fit.board = Board::charuco(9, 6, 0.025, false).unwrap();
    let named = "compare the names in the drawing of the rig below";
    assert!(page_of(&fit).contains(named) && !page_of(&fit).contains("mirrored"));
    fit.cameras.truncate(1);
    fit.links.clear();
    fit.residuals.retain(|view| view.camera == 0);
    assert!(page_of(&fit).contains(zoomed) && !page_of(&fit).contains("mirrored"));
    assert!(!page_of(&fit).contains(named));
}

#[test]
fn the_uncertainty_of_each_line_of_sight_is_drawn_over_the_picture() {
    let mut fit = fit();
    let mut html = String::new();
    uncertainty::maps(&mut html, &fit);
    assert_eq!(html, "");
    let cells = Projection::MAP[0] * Projection::MAP[1];
    let mut map_px: Vec<Option<f64>> = vec![Some(0.02); cells];
    (map_px[0], map_px[9]) = (None, Some(0.08));
    fit.cameras[1].projection = Some(Projection {
        rms_px: 0.03,
        map_px,
        ..Projection::default()
    });
    uncertainty::maps(&mut html, &fit);
    assert_eq!(html.matches("<rect").count(), cells);
    // The second cell of the second row is the darkest.
    let darkest = "<rect x=\"40.0\" y=\"40.0\" width=\"40.0\" height=\"40.0\" fill=\"#d08020\" fill-opacity=\"0.80\"/>";
    assert_eq!(html.matches(darkest).count(), 1, "{html}");
    for words in [">80</text>", ">20</text>", "<b>c01</b>: 0.030 px"] {
        assert!(html.contains(words), "{words}");
    }
    assert!(!html.contains("<b>c00</b>"), "{html}");
}

#[test]
fn a_page_is_whole_and_names_what_is_red() {
    let fit = fit();
    let limits = Limits::default();
    let judgement = judge(&fit, &[], &BTreeMap::new(), &limits);
    let id = |name: &str| CameraId::new(name).unwrap();
    let no_board = "no board was found".to_owned();
    let rejected = ["p8", "p9", "p7"].map(|p| (id("c01"), p.to_owned(), no_board.clone()));
    let picture = |found, words: &str| ViewPicture {
        camera: id("c00"),
        placement: "p7".to_owned(),
        found,
        words: words.to_owned(),
        jpeg: b"foobar".to_vec(),
        size: [640, 480],
        corners: vec![(Point2::new(319.5, 239.5), Some(Vector2::new(0.0, 0.25)))],
    };
    let pictures = [
        picture(Found::LeftOut, "it moved"),
        picture(Found::Nothing, "no <board>"),
    ];
    let page = CalibrationPage {
        fit: &fit,
        judgement: &judgement,
        limits: &limits,
        missing: &["camera c00: the board has not been in these parts".to_owned()],
        placements: &["p6", "p7", "p8", "p9"].map(str::to_owned),
        rejected: &rejected,
        pictures: &pictures,
        lost: &[],
        warnings: &["camera c00: 2 of its 9 pictures are <turned>".to_owned()],
        depths: &[],
        depth_words: &[],
        scale: &["scale: nothing but the board's size sets it".to_owned()],
        sources: &["a&b.mcap".to_owned()],
    };
    let html = calibration_page(&page);
    for words in [
        "Calibration: <span class=\"poor\">doubtful",
        "<td class=\"bad\">0.900</td>",
        "a&amp;b.mcap",
        "placement p7: it moved",
        "c00 and c01: 1",
        "on placements held out, 1.50 times",
        "Look at its arrows below",
        "<li>Note: camera c00: 2 of its 9 pictures are &lt;turned&gt;</li>",
        "<b>1 of 3</b> views left out",
        "1 of 3 views (33 %) were left out, expected at most 20 %. See what",
        "<b>3</b> pictures without a board",
        "<td>camera c00</td><td>the board has not been in these parts</td>",
        "<td>c01</td><td>3</td><td>no board was found</td>",
        "<title>c00, p7: left out</title>",
        "<title>c01, p8: no board found</title>",
        "data:image/jpeg;base64,Zm9vYmFy",
        "<b>c00, p7</b>: no &lt;board&gt;",
        // A quarter of a pixel is 25 of the page's, from the middle of the picture.
        "M200.0 150.0l0.0 25.0",
        "&lt;script&gt;",
        "<h2>Scale</h2>\n<ul><li>nothing but the board",
    ] {
        assert!(html.contains(words), "{words}");
    }
    assert!(
        !html.contains("<script") && !html.contains("http"),
        "nothing runs and nothing is fetched"
    );
    for tag in ["svg", "table", "figure", "ul", "div"] {
        let opened =
            html.matches(&format!("<{tag}>")).count() + html.matches(&format!("<{tag} ")).count();
        assert_eq!(opened, html.matches(&format!("</{tag}>")).count(), "{tag}");
    }
    assert!(
        !html.contains("NaN") && !html.contains(">inf"),
        "numbers are numbers"
    );
}
