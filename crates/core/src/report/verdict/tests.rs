//! Tests the rules on made-up figures. Tests on simulated rigs, elsewhere, show that the figures reveal faults.

use super::*;
use crate::capture::{ColorFacts, LeftOutCamera, Silhouette};
use crate::frame::{CaptureId, Timestamp};
use crate::mesh;
use crate::reconstruct::region::{BesideRegions, BiasSource, InFrontOfHull, OutlineOffset};
use crate::reconstruct::uncertainty::UnrequiredPiece;
use crate::reconstruct::{Method, Provenance, silhouette};
use crate::report::{
    AtlasMeasures, ColorMeasures, Consistency, Exchanged, ModelMeasures, MovedCamera,
    ProvenanceMeasures, RegionMeasures, UnobservedMeasures,
};

fn id(name: &str) -> CameraId {
    CameraId::new(name).unwrap()
}

fn camera(name: &str, missing: f64) -> ColorMeasures {
    ColorMeasures {
        camera: id(name),
        sharpness_percent: Some(60),
        object_px: [800, 1000],
        consistency: Consistency {
            coverage: 1.0 - missing,
            missing,
            ..Consistency::default()
        },
        silhouette: silhouette::Facts::default(),
    }
}

fn measured() -> Measurements {
    Measurements {
        colors: ["c00", "c01", "c02"].map(|name| camera(name, 0.0)).to_vec(),
        moved: None,
        exchanged: None,
        common_shift_share: 0.0004,
        depths: Vec::new(),
        depth_cameras: 0,
        model: ModelMeasures {
            watertight: true,
            mesh: mesh::Report::default(),
            bounds: [[0.0; 3]; 2],
            cell_size: 1e-3,
            provenance: vec![ProvenanceMeasures {
                provenance: Provenance::Hull,
                share: 1.0,
                mean_expected_error: 1e-4,
            }],
            mean_expected_error: 1e-4,
            unobserved: UnobservedMeasures::default(),
            textured: Some(0.9),
            atlas: None,
            dropped_hull_pieces: 0,
            dropped_carved_pieces: 0,
            closed_openings: 0,
            even_walls: None,
            fairing: None,
            fairing_remark: None,
            fairing_refused: None,
            unproved_volume: None,
            unrequired_pieces: Vec::new(),
            handles_of_depth: 0,
        },
        method: Method::Hybrid,
    }
}

fn capture() -> CaptureFacts {
    let color = |name| ColorFacts {
        camera: id(name),
        delay_ns: 0,
        silhouette: Silhouette::Background {
            age_ns: 60_000_000_000,
        },
    };
    CaptureFacts {
        id: CaptureId::new("cup-000").unwrap(),
        time_ns: Timestamp(1),
        source: "pedal".into(),
        subject: None,
        placement: None,
        skew_ns: 0,
        colors: ["c00", "c01", "c02"].map(color).to_vec(),
        depths: Vec::new(),
        calibration: None,
        left_out: Vec::new(),
        warnings: Vec::new(),
        damage: Vec::new(),
    }
}

#[test]
fn a_model_is_no_better_than_its_calibration() {
    use crate::calibration::{CalibrationLevel, CalibrationVerdict};
    let level = |worth| {
        let mut capture = capture();
        capture.calibration = Some(CalibrationVerdict {
            level: worth,
            reasons: vec!["camera c02 moved by 0.70°".into(), "rms 0.5 px".into()],
        });
        let verdict = judged(&measured(), &capture);
        let mut doubts = verdict.reasons.iter();
        let doubt = doubts.find(|r| r.code == ReasonCode::CalibrationDoubtful);
        (verdict.level, doubt.map(|r| r.words.clone()))
    };
    assert_eq!(level(CalibrationLevel::Good), (Level::Green, None));
    assert_eq!(level(CalibrationLevel::Accepted), (Level::Green, None));
    let words = "the calibration is doubtful: camera c02 moved by 0.70° (2 reasons in all)";
    let doubtful = (Level::Amber, Some(words.to_owned()));
    assert_eq!(level(CalibrationLevel::Doubtful), doubtful);
    assert_eq!(level(CalibrationLevel::Refused).0, Level::Red);
}

/// Parameters of a rig that is to make hulls only, because the rig of [`measured`] has no depth camera.
fn judged(measured: &Measurements, capture: &CaptureFacts) -> Verdict {
    let parameters = Parameters {
        hull_is_wanted: true,
        ..Parameters::default()
    };
    judge(measured, capture, &parameters)
}

fn codes(verdict: &Verdict, level: Level) -> Vec<ReasonCode> {
    let of_level = verdict.reasons.iter().filter(|r| r.level == level);
    of_level.map(|r| r.code).collect()
}

#[test]
fn a_little_interpolation_is_a_note_and_much_is_a_reason() {
    let of = |share: f64| {
        let mut measured = measured();
        measured.model.provenance[0].share = 1.0 - share;
        measured.model.provenance.push(ProvenanceMeasures {
            provenance: Provenance::Bridged,
            share,
            mean_expected_error: 1e-4,
        });
        let verdict = judge(&measured, &capture(), &Parameters::default());
        let found = verdict.reasons.into_iter();
        let mut found = found.filter(|reason| reason.code == ReasonCode::HolesBridged);
        found.next().map(|reason| reason.level)
    };
    assert_eq!(of(0.02), None);
    assert_eq!(of(0.2), Some(Level::Green));
    assert_eq!(of(0.3), Some(Level::Amber));
}

#[test]
fn a_model_of_silhouettes_alone_is_to_be_looked_at_unless_it_is_wanted() {
    let mut measured = measured();
    measured.model.mesh.volume = 340e-6;
    for code in [ReasonCode::NoDepthCamera, ReasonCode::DepthNotUsed] {
        let verdict = judge(&measured, &capture(), &Parameters::default());
        assert_eq!(codes(&verdict, Level::Amber), [code]);
        let wanted = judged(&measured, &capture());
        assert_eq!(wanted.level, Level::Green);
        assert_eq!(codes(&wanted, Level::Green), [code]);
        let words = &wanted.reasons[0].words;
        assert!(
            words.contains("340 cubic centimetres may be hollow"),
            "{words}"
        );
        (measured.depth_cameras, measured.method) = (1, Method::Hull);
    }
}

#[test]
fn what_nothing_looked_into_and_what_is_guessed_is_to_be_looked_at_unless_a_hull_is_wanted() {
    let of = |guessed, lids| {
        let mut measured = measured();
        measured.depth_cameras = 1;
        let mut depth = crate::report::DepthMeasures::nothing(id("kinect"));
        (depth.facts.measured, depth.coverage) = (1000, 0.9);
        measured.depths = vec![depth];
        measured.model.unobserved = UnobservedMeasures {
            guessed,
            lids,
            under_lids: 120e-6,
            ..UnobservedMeasures::default()
        };
        measured
    };
    let amber = |measured: &Measurements| {
        codes(
            &judge(measured, &capture(), &Parameters::default()),
            Level::Amber,
        )
    };
    assert_eq!(amber(&of(0.13, 0.045)), []);
    assert_eq!(amber(&of(0.0, 0.06)), [ReasonCode::LidUnread]);
    assert_eq!(amber(&of(0.15, 0.045)), [ReasonCode::Unobserved]);
    // A reading beneath the surface is no less than none.
    let mut seen_through = of(0.0, 0.0);
    seen_through.model.unobserved.seen_through = 0.06;
    assert_eq!(amber(&seen_through), [ReasonCode::Unobserved]);
    let both = of(0.3, 0.06);
    assert_eq!(
        amber(&both),
        [ReasonCode::LidUnread, ReasonCode::Unobserved]
    );
    let wanted = judged(&both, &capture());
    assert_eq!(wanted.level, Level::Green);
    let mut words = wanted.reasons.iter().map(|r| r.words.as_str());
    assert!(
        words.any(|w| w.contains("up to 120 cubic centimetres below it")),
        "{wanted:?}"
    );
}

#[test]
fn a_hollow_whose_depth_nothing_checks_is_told() {
    let of = |source| {
        let mut measured = measured();
        measured.depth_cameras = 1;
        let mut depth = crate::report::DepthMeasures::nothing(id("kinect"));
        // However little of the object it reads, it read a hollow.
        (depth.facts.measured, depth.coverage) = (1000, 0.02);
        (depth.bias.source, depth.bias.remaining) = (source, 8e-3);
        depth.regions = Some(RegionMeasures {
            count: 1,
            free_space_count: 0,
            free_space_pixels: 0,
            pixels: 1000,
            share: 0.5,
            coverage: 0.9,
            filled: 0.1,
            empty: 0.0,
            median_depth: 0.02,
            greatest_depth: 0.04,
            model_behind_depth: 0.0,
            disagreement: 0.5e-3,
        });
        measured.depths = vec![depth];
        judged(&measured, &capture())
    };
    assert_eq!(codes(&of(BiasSource::Table), Level::Green), []);
    let verdict = of(BiasSource::None);
    assert_eq!(codes(&verdict, Level::Green), [ReasonCode::DepthUnchecked]);
    let words = &verdict.reasons[0].words;
    assert!(words.contains("kinect; it may be up to 8.0 mm"), "{words}");
}

#[test]
fn depth_behind_a_hull_that_may_be_too_large_is_told_and_depth_in_front_is_known() {
    let of = |found| {
        let mut measured = measured();
        measured.depth_cameras = 1;
        let mut depth = crate::report::DepthMeasures::nothing(id("kinect"));
        (depth.facts.measured, depth.coverage) = (1000, 0.9);
        (depth.bias.source, depth.bias.found) = (BiasSource::Hull, found);
        depth.bias.remaining = 8e-3;
        measured.depths = vec![depth];
        codes(&judged(&measured, &capture()), Level::Green)
    };
    let (none, told) = (ReasonCode::NoRegion, ReasonCode::DepthUnchecked);
    assert_eq!(of(7e-3), [none, told]);
    assert_eq!(of(-7e-3), [none]);
}

#[test]
fn an_outline_that_the_depth_has_elsewhere_is_amber_and_names_the_camera() {
    let of = |apart: f64| {
        let mut measured = measured();
        let mut depth = crate::report::DepthMeasures::nothing(id("kinect"));
        (depth.facts.measured, depth.coverage) = (1000, 0.9);
        depth.outline = Some(OutlineOffset {
            places: 300,
            outwards: -apart,
            apart,
        });
        measured.depth_cameras = 1;
        measured.depths = vec![depth];
        judged(&measured, &capture())
    };
    assert_eq!(of(0.9e-3).level, Level::Green);
    let verdict = of(3e-3);
    assert_eq!(codes(&verdict, Level::Amber), [ReasonCode::DepthOutline]);
    let words = &verdict.reasons[0].words;
    assert!(words.contains("kinect (3.0 mm)"), "{words}");
}

#[test]
fn an_object_that_was_read_elsewhere_is_amber_beyond_what_the_bias_may_be() {
    let of = |found: Option<(f64, f64)>| {
        let mut measured = measured();
        let mut depth = crate::report::DepthMeasures::nothing(id("kinect"));
        (depth.facts.measured, depth.coverage) = (1000, 0.9);
        depth.beside_regions = found.map(|(low, median)| BesideRegions {
            pixels: 300,
            low,
            median,
            bias_error: 0.4e-3,
        });
        measured.depth_cameras = 1;
        measured.depths = vec![depth];
        judged(&measured, &capture())
    };
    for sound in [None, Some((0.9e-3, 1.1e-3)), Some((-1.1e-3, -0.2e-3))] {
        assert_eq!(of(sound).level, Level::Green, "{sound:?}");
    }
    for (found, said) in [
        ((-1.9e-3, -0.7e-3), "in front of"),
        ((0.4e-3, 1.9e-3), "behind"),
    ] {
        let verdict = of(Some(found));
        assert_eq!(codes(&verdict, Level::Amber), [ReasonCode::DepthElsewhere]);
        let words = &verdict.reasons[0].words;
        assert!(
            words.contains(said) && words.contains("kinect (1.5 mm)"),
            "{words}"
        );
    }
}

#[test]
fn a_rim_that_was_read_in_front_of_the_hull_is_amber() {
    let of = |pixels| {
        let mut measured = measured();
        let mut depth = crate::report::DepthMeasures::nothing(id("kinect"));
        (depth.facts.measured, depth.coverage) = (1000, 0.9);
        depth.in_front_of_hull = Some(InFrontOfHull {
            pixels,
            median: 3.5e-3,
            bias_error: 0.5e-3,
        });
        measured.depth_cameras = 1;
        measured.depths = vec![depth];
        judged(&measured, &capture())
    };
    assert_eq!(of(3).level, Level::Green);
    let verdict = of(300);
    assert_eq!(codes(&verdict, Level::Amber), [ReasonCode::DepthElsewhere]);
    let words = &verdict.reasons[0].words;
    assert!(
        words.starts_with("the depth has the object in front of"),
        "{words}"
    );
    assert!(words.contains("kinect (3.0 mm)"), "{words}");
}

#[test]
fn a_model_that_expects_a_large_error_is_to_be_looked_at() {
    let mut measured = measured();
    let mut of = |metres| {
        measured.model.mean_expected_error = metres;
        judged(&measured, &capture())
    };
    assert_eq!(of(1.1e-3).level, Level::Green);
    let verdict = of(1.9e-3);
    assert_eq!(codes(&verdict, Level::Amber), [ReasonCode::ErrorLarge]);
    assert!(
        verdict.reasons[0].words.contains("1.9 mm on average"),
        "{verdict:?}"
    );
}

#[test]
fn pictures_that_do_not_fit_into_the_texture_are_told_and_no_camera_is_blamed() {
    let mut measured = measured();
    measured.model.textured = Some(0.0);
    measured.model.atlas = Some(AtlasMeasures {
        size: [1, 1],
        used: 0.0,
        texel_size: None,
    });
    let verdict = judged(&measured, &capture());
    assert_eq!(codes(&verdict, Level::Amber), [ReasonCode::Unpainted]);
    let words = &verdict.reasons[0].words;
    assert!(words.contains("texture.largest_side"), "{words}");
}

#[test]
fn a_hole_that_only_depth_shows_is_to_be_looked_at() {
    let mut measured = measured();
    measured.model.handles_of_depth = 1;
    let verdict = judged(&measured, &capture());
    assert_eq!(codes(&verdict, Level::Amber), [ReasonCode::OpenedByDepth]);
}

#[test]
fn a_model_in_several_pieces_is_to_be_looked_at() {
    let mut measured = measured();
    measured.model.mesh.components = 1;
    assert_eq!(judged(&measured, &capture()).level, Level::Green);
    measured.model.mesh.components = 4;
    let verdict = judged(&measured, &capture());
    assert_eq!(
        codes(&verdict, Level::Amber),
        [ReasonCode::SeveralComponents]
    );
    assert!(verdict.reasons[0].words.contains("in 4 separate pieces"));
}

#[test]
fn a_camera_that_moved_is_named_and_the_ones_it_harms_are_not() {
    let mut measured = measured();
    measured.colors[0] = camera("c00", 0.01);
    measured.moved = Some(MovedCamera {
        camera: id("c01"),
        shift_px: [12.0, -3.4],
        shift_share: 0.012,
        others_share_with: 0.01,
        others_share_without: 0.001,
    });
    let verdict = judged(&measured, &capture());
    assert_eq!(codes(&verdict, Level::Amber), [ReasonCode::CameraDisplaced]);
    let reason = &verdict.reasons[0];
    assert_eq!(reason.cameras, [id("c01")]);
    assert!(reason.words.contains("c01 (by 1.2 %"), "{}", reason.words);
    assert!(reason.words.contains("+12.0, -3.4 px"), "{}", reason.words);
    measured.moved.as_mut().unwrap().shift_share = 0.05;
    assert_eq!(judged(&measured, &capture()).level, Level::Red);
    // What a shadow at its foot displaces does not blame a camera.
    measured.moved.as_mut().unwrap().shift_px = [0.1, 1.3];
    let codes = codes(&judged(&measured, &capture()), Level::Amber);
    assert!(!codes.contains(&ReasonCode::CameraDisplaced), "{codes:?}");
}

#[test]
fn a_calibration_of_another_recording_is_red_and_named_before_what_it_brings_about() {
    let mut measured = measured();
    measured.colors[0] = camera("c00", 0.2);
    measured.common_shift_share = 0.0029;
    let of_one = judged(&measured, &capture());
    assert_eq!(
        codes(&of_one, Level::Red),
        [ReasonCode::SilhouetteUncovered]
    );
    measured.common_shift_share = 0.0136;
    // In small pictures that is what a shadow brings about.
    measured
        .colors
        .iter_mut()
        .for_each(|c| c.consistency.shift_px = [0.9, -0.8]);
    assert!(
        !codes(&judged(&measured, &capture()), Level::Red)
            .contains(&ReasonCode::CalibrationForeign)
    );
    measured
        .colors
        .iter_mut()
        .for_each(|c| c.consistency.shift_px = [9.0, -4.0]);
    let foreign = judged(&measured, &capture());
    assert_eq!(
        codes(&foreign, Level::Red),
        [ReasonCode::CalibrationForeign]
    );
    let words = &foreign.reasons[0].words;
    assert!(
        words.contains("does not belong to this recording") && words.contains("1.4 %"),
        "{words}"
    );
    // One camera that moved may displace all, and is to blame if the others agree without it.
    let moved = |others_share_without| MovedCamera {
        camera: id("c01"),
        shift_px: [60.0, 0.0],
        shift_share: 0.06,
        others_share_with: 0.02,
        others_share_without,
    };
    measured.moved = Some(moved(0.001));
    let displaced = judged(&measured, &capture());
    assert_eq!(codes(&displaced, Level::Red), [ReasonCode::CameraDisplaced]);
    measured.moved = Some(moved(0.009));
    let foreign = judged(&measured, &capture());
    assert_eq!(
        codes(&foreign, Level::Red),
        [ReasonCode::CalibrationForeign]
    );
    measured.exchanged = Some(Exchanged {
        cameras: [id("c00"), id("c01")],
        missing_with: 0.2,
        missing_without: 0.001,
    });
    let exchanged = judged(&measured, &capture());
    assert_eq!(
        codes(&exchanged, Level::Red),
        [ReasonCode::CamerasExchanged]
    );
    let words = &exchanged.reasons[0].words;
    assert!(words.starts_with("c00 and c01 look exchanged"), "{words}");
}

#[test]
fn an_object_that_the_volume_cuts_is_named_beside_a_calibration_that_may_be_to_blame() {
    let mut measured = measured();
    measured.model.unobserved.cut_by_volume = 0.004;
    assert_eq!(codes(&judged(&measured, &capture()), Level::Amber), []);
    measured.model.unobserved.cut_by_volume = 0.12;
    let verdict = judged(&measured, &capture());
    assert_eq!(codes(&verdict, Level::Amber), [ReasonCode::VolumeCut]);
    let words = &verdict.reasons[0].words;
    assert!(words.contains("it bounds 12 % of the surface"), "{words}");
    measured.common_shift_share = 0.014;
    measured
        .colors
        .iter_mut()
        .for_each(|c| c.consistency.shift_px = [9.0, -4.0]);
    let verdict = judged(&measured, &capture());
    let [red, amber] = [Level::Red, Level::Amber].map(|level| codes(&verdict, level));
    assert_eq!(
        (red, amber),
        (
            vec![ReasonCode::CalibrationForeign],
            vec![ReasonCode::VolumeCut]
        )
    );
    let words = &verdict.reasons[0].words;
    assert!(
        words.ends_with("; or the volume cuts the object"),
        "{words}"
    );
}

#[test]
fn parts_of_a_silhouette_that_are_not_covered_are_amber() {
    let mut measured = measured();
    measured.colors[2] = camera("c02", 0.02);
    let verdict = judged(&measured, &capture());
    assert_eq!(
        codes(&verdict, Level::Amber),
        [ReasonCode::SilhouetteUncovered]
    );
    assert!(verdict.reasons[0].words.contains("c02 (2.0 %)"));
}

#[test]
fn the_gravest_reason_decides_and_comes_first() {
    let mut measured = measured();
    measured.model.dropped_carved_pieces = 200;
    measured.model.watertight = false;
    measured.colors[0].silhouette.edge_px = [0, 0, 300, 0];
    let verdict = judged(&measured, &capture());
    assert_eq!(verdict.level, Level::Red);
    assert_eq!(verdict.reasons[0].code, ReasonCode::NotWatertight);
    assert_eq!(
        codes(&verdict, Level::Amber),
        [ReasonCode::FrameCut, ReasonCode::PiecesDropped]
    );
}

#[test]
fn pieces_that_no_silhouette_requires_are_told_with_volume_and_place() {
    let piece = |volume, bounds| UnrequiredPiece { volume, bounds };
    let mut measured = measured();
    measured.model.unrequired_pieces = vec![
        piece(4e-6, [[0.1, -0.04, 0.0], [0.14, 0.0, 0.02]]),
        piece(1e-6, [[0.0; 3], [0.01; 3]]),
    ];
    let verdict = judged(&measured, &capture());
    assert_eq!(verdict.level, Level::Green);
    let mut told = verdict.reasons.iter();
    let told = told
        .find(|r| r.code == ReasonCode::PieceUnrequired)
        .unwrap();
    let words = &told.words;
    assert!(words.contains("2 pieces of 5.0 ml"), "{words}");
    assert!(words.contains("x 120, y -20, z 10 mm"), "{words}");
}

#[test]
fn a_capture_that_came_about_badly_is_amber() {
    let mut capture = capture();
    capture.skew_ns = 30_000_000;
    capture.colors[1].delay_ns = -30_000_000;
    capture.colors[2].silhouette = Silhouette::Background {
        age_ns: 48 * 3_600_000_000_000,
    };
    capture.left_out.push(LeftOutCamera {
        camera: id("c07"),
        reason: "it has no calibration".into(),
    });
    capture.warnings = (0..9).map(|n| format!("warning {n}")).collect();
    let verdict = judged(&measured(), &capture);
    let ambers = codes(&verdict, Level::Amber);
    assert_eq!(
        ambers[..3],
        [
            ReasonCode::Skew,
            ReasonCode::BackgroundOld,
            ReasonCode::CameraLeftOut
        ]
    );
    assert_eq!(
        ambers.len(),
        3 + 6,
        "five warnings and a count of the others"
    );
    assert_eq!(verdict.reasons[0].cameras, [id("c01")]);
    assert!(verdict.reasons[1].words.contains("c02 (48 h)"));
}

#[test]
fn a_depth_camera_that_gave_nothing_is_amber() {
    let mut measured = measured();
    measured.depth_cameras = 1;
    measured.depths = vec![crate::report::DepthMeasures::nothing(id("kinect"))];
    let verdict = judged(&measured, &capture());
    assert_eq!(codes(&verdict, Level::Amber), [ReasonCode::NoDepth]);
    measured.method = Method::Hull;
    assert_eq!(
        codes(&judged(&measured, &capture()), Level::Green),
        [ReasonCode::DepthNotUsed]
    );
}

#[test]
fn several_depth_cameras_that_gave_nothing_are_several_in_words() {
    let mut measured = measured();
    measured.depth_cameras = 2;
    measured.depths = ["d00", "d01"]
        .map(|name| crate::report::DepthMeasures::nothing(id(name)))
        .to_vec();
    let verdict = judged(&measured, &capture());
    let words = &verdict.reasons[0].words;
    assert!(
        words.starts_with("depth cameras d00, d01 have hardly any readings of the object: "),
        "{words}"
    );
}

#[test]
fn many_cameras_make_one_reason() {
    let mut measured = measured();
    measured.colors = (0..30).map(|n| camera(&format!("c{n:02}"), 0.01)).collect();
    let verdict = judged(&measured, &capture());
    assert_eq!(verdict.reasons[0].cameras.len(), 30);
    assert!(
        verdict.reasons[0].words.ends_with("26 more"),
        "{}",
        verdict.reasons[0].words
    );
}

#[test]
fn what_is_no_number_is_red() {
    let limits = Limits {
        amber: 1.0,
        red: Some(2.0),
    };
    assert_eq!(limits.level(1.0), None);
    assert_eq!(limits.level(1.5), Some(Level::Amber));
    assert_eq!(limits.level(f64::NAN), Some(Level::Red));
}

#[test]
fn a_limit_that_is_not_given_is_the_default_and_amber_is_not_above_red() {
    let read = |text: &str| toml::from_str::<Parameters>(text);
    let given = |text: &str| read(text).unwrap();
    let limits = |amber, red| Limits { amber, red };
    let displaced = |text: &str| given(text).displaced;
    assert_eq!(
        displaced("displaced.amber = 0.004"),
        limits(0.004, Some(0.03))
    );
    assert_eq!(displaced("displaced.red = 0.01"), limits(0.005, Some(0.01)));
    assert_eq!(
        displaced("displaced.red = inf"),
        limits(0.005, Some(f64::INFINITY))
    );
    let frame_cut = given("frame_cut.red = 0.1").frame_cut;
    assert_eq!(frame_cut, limits(0.02, Some(0.1)));
    assert_eq!(given("frame_cut.amber = 0.1").frame_cut.red, None);
    for text in [
        "displaced = { amber = 0.05, red = 0.001 }",
        "displaced.red = 0.001",
        "displaced.amber = 0.05",
    ] {
        let error = read(text).unwrap_err().message().to_owned();
        for field in ["displaced.amber", "displaced.red"] {
            assert!(error.contains(field), "{text}: {error}");
        }
    }
}

#[test]
fn limits_are_read_from_a_file_and_misspelt_ones_refused() {
    let read: Parameters = toml::from_str("skew_ms = { amber = 1, red = 3 }").unwrap();
    assert_eq!(read.skew_ms.red, Some(3.0));
    assert!(toml::from_str::<Parameters>("skew_ms = { ambre = 1 }").is_err());
    let written = toml::to_string(&Parameters::default()).unwrap();
    assert_eq!(
        toml::from_str::<Parameters>(&written).unwrap(),
        Parameters::default()
    );
}

#[test]
fn the_schema_of_the_report_knows_each_reason_and_no_other() {
    use serde::de::{Deserialize, IntoDeserializer};

    let schema = include_str!("../../../../../docs/report.schema.json");
    let schema: serde_json::Value = serde_json::from_str(schema).unwrap();
    let schema = &schema["$defs"]["reason"]["properties"]["code"]["enum"];
    // Serde answers a word that it does not know with all that it knows, in backticks.
    let refused: Result<ReasonCode, serde::de::value::Error> =
        ReasonCode::deserialize("unheard of".into_deserializer());
    let refused = refused.unwrap_err().to_string();
    let codes: Vec<&str> = refused.split('`').skip(3).step_by(2).collect();
    assert!(codes.len() > 2, "{refused}");
    assert_eq!(schema, &serde_json::json!(codes));
    // The page that explains them to people has an entry for each, and for no other.
    let page = include_str!("../../../../../docs/results.md");
    let (_, page) = page.split_once("\n## The silhouettes\n").unwrap();
    let rows = page.lines().filter_map(|line| line.strip_prefix("| `"));
    let mut explained: Vec<&str> = rows.filter_map(|row| row.split('`').next()).collect();
    let mut known = codes.clone();
    explained.sort_unstable();
    known.sort_unstable();
    assert_eq!(explained, known);
}

/// Each row of an amber or red reason has a picture that is there.
#[test]
fn the_page_of_results_shows_each_amber_and_red_reason() {
    let page = include_str!("../../../../../docs/results.md");
    let pictures = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/reasons");
    let (_, page) = page.split_once("\n## The silhouettes\n").unwrap();
    let mut shown = Vec::new();
    for row in page.lines().filter_map(|line| line.strip_prefix("| `")) {
        let (code, words) = row.split_once('`').unwrap();
        if page.contains(&format!("](reasons/{code}.png)")) {
            shown.push(format!("{code}.png"));
        } else {
            let is_note = words.contains("does not change the verdict");
            assert!(is_note, "{code} has no picture");
        }
    }
    let files = std::fs::read_dir(pictures).unwrap();
    let mut files: Vec<String> = files
        .map(|file| file.unwrap().file_name().into_string().unwrap())
        .collect();
    shown.sort_unstable();
    files.sort_unstable();
    assert_eq!(shown, files);
}
