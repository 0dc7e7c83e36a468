//! Tests that simulated faults appear as the options say, and that each preset is a session.

use super::*;
use scand_core::frame::{Picture, Stream};

fn faulty(change: impl FnOnce(&mut Options)) -> Simulation {
    let mut options = Options::small(Shape::Cup);
    options.cameras = 4;
    options.depth.frames = 2;
    change(&mut options);
    Simulation::new(options).unwrap()
}

fn fault(camera: &str, amount: f64) -> Vec<CameraFault> {
    vec![CameraFault {
        camera: camera.to_owned(),
        amount,
    }]
}

#[test]
fn a_turned_camera_is_not_where_its_calibration_says() {
    let turned = faulty(|o| o.faults.turned_deg = fault("c01", 1.5));
    for (k, station) in turned.rig().colors.iter().enumerate() {
        let difference = station
            .actual
            .rig_from_camera
            .rotation
            .angle_to(&station.calibrated.rig_from_camera.rotation);
        let expected = if k == 1 { 1.5_f64.to_radians() } else { 0.0 };
        assert!(
            (difference - expected).abs() < 1e-6,
            "c{k:02}: {difference}"
        );
    }
}

#[test]
fn blur_softens_and_exposure_clips() {
    // The sum of squared steps from pixel to pixel falls with blur.
    let sharpness = |simulation: &Simulation| {
        let image = simulation.scene(0).colors.remove(2).image;
        let steps = |row: &[[u8; 3]]| {
            let step = |w: &[[u8; 3]]| (f64::from(w[1][1]) - f64::from(w[0][1])).powi(2);
            row.windows(2).map(step).sum::<f64>()
        };
        (0..image.height())
            .map(|y| steps(image.row(y)))
            .sum::<f64>()
    };
    let without_noise = |o: &mut Options| o.color.full_well = 0.0;
    let sharp = sharpness(&faulty(without_noise));
    let soft = sharpness(&faulty(|o| {
        without_noise(o);
        o.faults.blurred_px = fault("c02", 4.0);
    }));
    assert!(soft < 0.5 * sharp, "{soft} and {sharp}");
    let clipped = |simulation: &Simulation| {
        let image = simulation.scene(0).colors.remove(0).image;
        image.pixels().iter().filter(|p| p[1] == 255).count()
    };
    assert_eq!(clipped(&faulty(|_| ())), 0);
    assert!(clipped(&faulty(|o| o.faults.overexposed_stops = fault("c00", 3.0))) > 500);
}

#[test]
fn missing_late_empty_and_blind() {
    let of = |simulation: &Simulation, name: &str| {
        let frames = simulation.capture(0).unwrap().frames;
        let times: Vec<_> = frames
            .into_iter()
            .filter(|f| f.camera.as_str() == name)
            .collect();
        times
    };
    let missing = faulty(|o| o.faults.missing = vec!["c03".into()]);
    assert!(of(&missing, "c03").is_empty());
    assert_eq!(missing.scene(0).colors.len(), 3);
    let late = faulty(|o| o.faults.late_ms = fault("c02", 40.0));
    let on_time = of(&faulty(|_| ()), "c02")[0].timestamp;
    assert_eq!(
        of(&late, "c02")[0].timestamp.nanoseconds_since(on_time),
        40_000_000
    );
    let dropped = faulty(|o| o.faults.no_background = vec!["c00".into()]);
    assert_eq!(dropped.backgrounds().len(), 3);
    let blind = faulty(|o| o.faults.no_depth = true);
    for frame in of(&blind, "kinect")
        .iter()
        .filter(|f| f.stream == Stream::Depth)
    {
        let Picture::Raw { data, .. } = &frame.picture else {
            panic!("not raw");
        };
        assert!(data.iter().all(|b| *b == 0));
    }
    let empty = faulty(|o| o.faults.empty_table = true);
    assert!(
        empty
            .masks()
            .iter()
            .all(|m| m.pixels().iter().all(|p| *p == 0))
    );
    // Nothing but noise tells an empty table from its background.
    for view in empty.scene(0).colors {
        let scand_core::reconstruct::SilhouetteSource::Background(plate) = &view.silhouette else {
            panic!("no background");
        };
        let pairs = view.image.pixels().iter().zip(plate.pixels());
        let sum: i64 = pairs.map(|(a, b)| i64::from(a[2]) - i64::from(b[2])).sum();
        assert!(sum.abs() < 8 * 320 * 240, "{}", view.camera.id);
    }
}

#[test]
fn options_that_cannot_be_met_are_refused_by_name() {
    let refused = |change: &dyn Fn(&mut Options)| {
        let mut options = Options::small(Shape::Ball);
        change(&mut options);
        Simulation::new(options).unwrap_err().to_string()
    };
    let message = refused(&|o| o.faults.missing = vec!["c99".into()]);
    assert!(message.contains("c99"), "{message}");
    assert!(refused(&|o| o.cameras = 1000).contains("1000"));
    assert!(refused(&|o| o.cameras = 1).contains("cameras is 1, expected 2 to 99"));
    assert!(refused(&|o| o.captures = 0).contains("captures is 0, expected at least 1"));
    let message = refused(&|o| (o.cameras, o.low_cameras) = (8, Some(9)));
    assert!(
        message.contains("low cameras is 9, expected at most 8"),
        "{message}"
    );
    for (cameras, slant, expected) in [(1, 90.0, "0 to 85"), (2, 65.0, "0 to 50")] {
        let message = refused(&|o| (o.depth_cameras, o.depth_slant_deg) = (cameras, slant));
        assert!(message.contains("depth slant"), "{message}");
        assert!(message.contains(expected), "{message}");
    }
    for quality in [0, 101] {
        let message = refused(&|o| o.color.jpeg_quality = quality);
        assert!(message.contains("JPEG quality is"), "{message}");
    }
    assert!(refused(&|o| o.depth.color_jpeg_quality = 101).contains("101, expected 0 to 100"));
    assert!(refused(&|o| o.width = 0).contains("0x240"));
    assert!(refused(&|o| o.spacing_mm = f64::NAN).contains("spacing"));
}

#[test]
fn a_depth_camera_is_refused_the_faults_that_it_cannot_have() {
    let refused = |change: &dyn Fn(&mut Faults)| {
        let mut options = Options::small(Shape::Ball);
        change(&mut options.faults);
        let with_object = Simulation::new(options.clone()).unwrap_err().to_string();
        let with_board = BoardSession::new(options, BoardOptions::default());
        assert_eq!(with_board.err().unwrap().to_string(), with_object);
        with_object
    };
    for (message, named) in [
        (
            refused(&|f| f.turned_deg = fault("kinect", 5.0)),
            "turned camera",
        ),
        (refused(&|f| f.cut_off = fault("kinect", 0.3)), "cuts off"),
        (
            refused(&|f| f.blurred_px = fault("kinect", 3.0)),
            "blurred camera",
        ),
        (
            refused(&|f| f.overexposed_stops = fault("kinect", 2.0)),
            "overexposed",
        ),
        (
            refused(&|f| f.no_background = vec!["kinect".into()]),
            "background",
        ),
    ] {
        let expected = "is the depth camera kinect, expected a colour camera";
        assert!(
            message.contains(named) && message.contains(expected),
            "{message}"
        );
    }
}

#[test]
fn a_depth_camera_may_be_late_in_either_session() {
    let begin = |late_ms: f64| {
        let mut options = Options::small(Shape::Ball);
        (options.cameras, options.depth.frames) = (2, 1);
        options.faults.late_ms = fault("kinect", late_ms);
        let boards = BoardOptions {
            placements: 1,
            ..BoardOptions::default()
        };
        let with_board = BoardSession::new(options.clone(), boards).unwrap();
        let with_object = Simulation::new(options).unwrap();
        let captures = [
            with_object.capture(0).unwrap(),
            with_board.capture(0).unwrap(),
        ];
        captures.map(|capture| {
            let mut frames = capture.frames.into_iter();
            frames
                .find(|f| f.stream == Stream::Depth)
                .unwrap()
                .timestamp
        })
    };
    for (late, on_time) in begin(40.0).into_iter().zip(begin(0.0)) {
        assert_eq!(late.nanoseconds_since(on_time), 40_000_000);
    }
}

#[test]
fn every_preset_is_a_session() {
    for preset in Preset::ALL {
        let mut options = preset.options();
        (options.width, options.height, options.spacing_mm) = (80, 60, 6.0);
        options.depth.frames = 1;
        let simulation = Simulation::new(options).unwrap();
        let scene = simulation.scene(0);
        assert_eq!(scene.colors.len(), 11);
        let two = preset == Preset::TwoDepthCameras;
        assert_eq!(scene.depths.len(), 1 + usize::from(two));
    }
}

#[test]
fn a_recording_gives_back_what_was_simulated() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mug.mcap");
    let mut options = Options::small(Shape::Mug);
    options.captures = 2;
    options.cameras = 3;
    options.depth.frames = 10;
    let simulation = Simulation::new(options).unwrap();
    write(&simulation, &path, recording::Compression::Zstd).unwrap();
    assert!(
        write(&simulation, &path, recording::Compression::None).is_err(),
        "not overwritten"
    );
    let recording = recording::Recording::open(&path).unwrap();
    assert!(recording.damage().is_empty());
    let told = recording
        .metadata()
        .iter()
        .find(|(name, _)| name == "session")
        .unwrap();
    let options: Options = serde_json::from_str(&told.1["simulation"]).unwrap();
    assert_eq!(&options, simulation.options());
    let parameters = scand_core::sync::Parameters::default();
    let loader = scand_core::capture::CaptureSession::of(recording, &parameters).unwrap();
    assert_eq!(loader.captures().len(), 2);
    let id = scand_core::frame::CaptureId::new("mug-001").unwrap();
    let (scene, _) = loader.load(&id).unwrap();
    let expected = simulation.scene(1);
    // JSON keeps a number to its last bit but one.
    assert!((scene.volume.max - expected.volume.max).norm() < 1e-12);
    assert_eq!(scene.colors.len(), 3);
    assert_eq!(scene.colors[1].camera, expected.colors[1].camera);
    assert_eq!(scene.depths[0].camera, expected.depths[0].camera);
    let readings = |s: &scand_core::reconstruct::Scene| s.depths[0].frames[9].readings.clone();
    assert!(readings(&scene) == readings(&expected));
}
