//! Mouths of hollows that no depth camera read: a table that covered one in another capture shows nothing of what lies
//! beneath it.

use super::gain::with_true_poses;
use super::{Recorded, session};
use scand_lab::Shape;

#[test]
fn a_mouth_that_no_depth_camera_read_is_a_lid_whichever_capture_gives_the_frame() {
    for words in ["upright,flip", "flip,upright"] {
        let mut options = session(Shape::Mug, false, 640, words, 3);
        options.masks = true;
        options.faults.calibration_px = 0.0;
        options.faults.no_depth = true;
        let fused = with_true_poses(&Recorded::new(options));
        let model = &fused.report.as_ref().unwrap()["model"];
        let figure = |value: &serde_json::Value| value.as_f64().unwrap();
        let unobserved = &model["unobserved"];
        // The mouth, which lay on the table of one capture, is a tenth of the surface of the filled mug.
        assert!(figure(&unobserved["lids"]) > 0.1, "{words}: {unobserved}");
        // Half a litre fits under it.
        assert!(
            figure(&unobserved["under_lids"]) > 3e-4,
            "{words}: {unobserved}"
        );
        let stated_mm = 1e3 * figure(&model["mean_expected_error"]);
        assert!(stated_mm > 0.5, "{words}: {stated_mm} mm");
    }
}
