//! A fused scene has many more views than a capture.

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use crate::fusion_trial::gain::{first, with_true_poses};
    use crate::fusion_trial::{Recorded, session};
    use scand_lab::Shape;

    #[test]
    fn six_captures_of_eleven_colour_and_eleven_depth_cameras_are_one_scene_of_66_each() {
        let words = "upright,flip,side:35,turn:90,side:200,turn:200";
        let mut options = session(Shape::Mug, false, 640, words, 3);
        options.masks = true;
        options.depth_cameras = 11;
        (options.depth.frames, options.depth.color_every) = (10, 10);
        options.faults.calibration_px = 0.0;
        let recorded = Recorded::new(options);
        let fused = with_true_poses(&recorded);
        assert_eq!(fused.code, Some(0), "{}", fused.words);
        let report = fused.report.as_ref().unwrap();
        let count = |cameras: &str| report[cameras].as_array().unwrap().len();
        assert_eq!([count("color_cameras"), count("depth_cameras")], [66, 66]);
        assert_eq!(report["model"]["watertight"], true);
        let six = fused.scores().unwrap();
        let one = first(&recorded, &["mug-000".to_owned()]).scores().unwrap();
        println!("of six captures {six:?}, of one {one:?}");
        assert!(six.f_at_1_mm >= one.f_at_1_mm - 0.005, "{six:?}, {one:?}");
        assert!(six.underside_mean_mm < 1.0, "{six:?}");
        assert!((0.9..1.15).contains(&six.volume_share), "{six:?}");
    }
}
