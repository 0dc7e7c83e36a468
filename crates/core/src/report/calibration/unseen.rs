//! What no session like this one can show, however small its residuals are: the person has to check it by hand.

use super::CalibrationPage;
use crate::calibration::BoardKind;
use crate::calibration::fit::Fit;
use std::fmt::Write;

/// The faults that would leave no trace in the pictures that were fitted, one sentence each.
fn faults(fit: &Fit) -> Vec<&'static str> {
    let by_itself = fit.cameras.len() == 1;
    let has_no_marks = fit.board.kind == BoardKind::Checkerboard;
    let mirrored = has_no_marks.then_some(match by_itself {
        true => {
            "If its pictures are mirrored, they fit as well, for a checkerboard has no marks: look at one of them, or show a \
             ChArUco board."
        }
        false => {
            "If the pictures of all cameras are mirrored, they give a consistent mirrored rig, for a checkerboard has no marks: \
             compare the drawing of the rig below with yours, or show a ChArUco board."
        }
    });
    let zoomed = by_itself.then_some(
        "A camera by itself that was zoomed by 1 % between two pictures fits a lens in between, and one that was moved fits \
         anyway: fix the camera, and do not touch its lens.",
    );
    let named = (!by_itself).then_some(
        "If two cameras were exchanged before the first placement, each has the other's name throughout: compare the names in \
         the drawing of the rig below with yours.",
    );
    mirrored.into_iter().chain(zoomed).chain(named).collect()
}

/// What has to be checked by hand.
pub(super) fn section(html: &mut String, page: &CalibrationPage<'_>) {
    let faults = faults(page.fit);
    if faults.is_empty() {
        return;
    }
    *html += "<h2>What these pictures cannot show</h2>\n<ul>";
    for fault in faults {
        let _ = write!(html, "<li>{fault}</li>");
    }
    *html += "</ul>\n";
}
