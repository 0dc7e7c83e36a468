//! Sessions that another renderer made, with lenses and noise of its own: how the object lay in each capture, and how
//! good the fused model is with its underside. They are not part of scand: without them the tests are skipped.

/// Tests of more than ten seconds: `make check` leaves them to `make test`.
mod long {
    use crate::desk::{Desk, said};
    use crate::fusion_trial::score::{PoseError, error, pose};
    use crate::fusion_trial::surface::Scores;
    use crate::shared_recordings::shared;
    use nalgebra::Isometry3;
    use scand::capture::CaptureSession;
    use scand::evaluate::load::load;
    use scand::make_model::read_poses;
    use scand::mesh::Mesh;
    use scand::sync;
    use serde_json::Value;
    use std::path::PathBuf;

    /// A session with its truth.
    struct Session {
        desk: Desk,
        recording: PathBuf,
        subject: String,
        /// The names of its captures.
        captures: Vec<String>,
        truth: Mesh,
        /// The file of poses, and what is in it.
        poses: PathBuf,
        rig_from_object: Vec<Isometry3<f64>>,
    }

    /// A fused model, or what was said instead.
    struct Made {
        code: Option<i32>,
        report: Value,
        words: String,
        scores: Option<Scores>,
    }

    impl Session {
        fn new(name: &str) -> Option<Self> {
            let file = |ending: &str| shared(&format!("objects/{name}.{ending}"));
            let (recording, poses) = (file("mcap")?, file("truth.json")?);
            let truth = load(&file("truth.ply")?).unwrap().mesh;
            let text = std::fs::read_to_string(&poses).unwrap();
            let opened = CaptureSession::open(&recording, &sync::Parameters::default()).unwrap();
            let captures = opened.captures();
            Some(Self {
                desk: Desk::new(),
                recording,
                subject: captures[0].subject.clone().unwrap(),
                captures: captures.iter().map(|c| c.id.to_string()).collect(),
                truth,
                rig_from_object: read_poses(&text).unwrap(),
                poses,
            })
        }

        /// Fuses the captures that are wanted into the folder `out`.
        fn run(&self, out: &str, name: &str, wanted: &[&str]) -> Made {
            let recording = self.recording.to_str().unwrap();
            let usual = ["fuse", recording, "--out", out];
            let fused = self.desk.run(&[&usual[..], wanted].concat());
            let stem = self.recording.file_stem().unwrap();
            let folder = self.desk.path(out).join(stem);
            let folder = folder.join(format!("{name}.object"));
            let report = std::fs::read(folder.join("report.json")).unwrap_or_default();
            let model = folder.join("model.ply");
            let model = model.exists().then(|| load(&model).unwrap().mesh);
            Made {
                code: fused.status.code(),
                report: serde_json::from_slice(&report).unwrap_or_default(),
                words: said(&fused),
                scores: model.map(|model| Scores::of(&model, &self.truth)),
            }
        }

        /// Fuses all captures, whose poses are to be found.
        fn found(&self) -> Made {
            self.run("found", &self.subject, &["--subject", &self.subject])
        }

        /// Fuses all captures with their true poses.
        fn as_it_lay(&self) -> Made {
            let poses = self.poses.to_str().unwrap();
            let wanted = ["--subject", &self.subject, "--poses", poses];
            self.run("given", &self.subject, &wanted)
        }

        /// Fuses the first captures.
        fn of_first(&self, count: usize) -> Made {
            let first = self.captures.iter().take(count);
            let wanted: Vec<&str> = first.flat_map(|id| ["--capture", id]).collect();
            self.run(&format!("first-{count}"), &self.captures[0], &wanted)
        }

        /// How far each later capture's pose is off.
        fn errors(&self, made: &Made, has_pattern: bool) -> Vec<PoseError> {
            let later = made.captures().iter().zip(&self.rig_from_object).skip(1);
            later
                .map(|(capture, truth)| {
                    let found = pose(&capture["rig_from_object"]).unwrap();
                    error(&self.truth, has_pattern, truth, &found)
                })
                .collect()
        }
    }

    impl Made {
        fn captures(&self) -> &[Value] {
            let captures = self.report["fusion"]["captures"].as_array();
            captures.unwrap_or_else(|| panic!("{}", self.words))
        }

        fn scores(&self) -> &Scores {
            let scores = self.scores.as_ref();
            scores.unwrap_or_else(|| panic!("{}", self.words))
        }

        /// The codes of reasons that come from the fusion and are more than notes.
        fn more_than_notes(&self) -> Vec<&str> {
            let of_fusion = ["capture_left_out", "turn_unknown", "pose_doubtful"];
            let reasons = self.report["verdict"]["reasons"].as_array().unwrap();
            let codes = reasons.iter().filter_map(|reason| reason["code"].as_str());
            codes.filter(|code| of_fusion.contains(code)).collect()
        }
    }

    #[test]
    fn a_figurine_in_three_poses_is_held_by_its_form() {
        let Some(session) = Session::new("figurine-3poses") else {
            return;
        };
        let made = session.found();
        assert_eq!(made.code, Some(0), "{}", made.words);
        for error in session.errors(&made, true) {
            let is_right = error.turned_deg <= 0.15 && error.moved_mm <= 0.15;
            assert!(is_right, "{error:?}");
        }
        assert!(made.more_than_notes().is_empty(), "{}", made.words);
        let (found, given) = (made.scores(), session.as_it_lay());
        println!("found {found:?}, given {:?}", given.scores);
        assert!(found.f_at_1_mm >= 0.87, "{found:?}");
        let least = given.scores().f_at_1_mm - 0.01;
        assert!(found.f_at_1_mm >= least, "{found:?}");
        assert!(found.underside_mean_mm <= 0.3, "{found:?}");
        // More captures do no harm.
        let fewer = [1, 2].map(|count| session.of_first(count).scores().f_at_1_mm);
        let of_each = [fewer[0], fewer[1], found.f_at_1_mm];
        let is_gain = |w: &[f64]| w[1] >= w[0] - 0.005;
        assert!(of_each.windows(2).all(is_gain), "{of_each:?}");
    }

    #[test]
    fn a_painted_cup_in_three_poses_is_held_by_its_colours() {
        let Some(session) = Session::new("painted-cup-3poses") else {
            return;
        };
        let made = session.found();
        assert_eq!(made.code, Some(0), "{}", made.words);
        for error in session.errors(&made, true) {
            assert!(error.turned_deg <= 0.5, "{error:?}");
        }
        let (found, given) = (made.scores(), session.as_it_lay());
        println!("found {found:?}, given {:?}", given.scores);
        let least = given.scores().f_at_1_mm - 0.015;
        assert!(found.f_at_1_mm >= least, "{found:?}");
        // Depth does not find the recess of its foot; without that, 0.89 would be there.
        assert!(found.f_at_1_mm >= 0.89, "{found:?}");
    }

    #[test]
    fn of_a_plain_cup_the_turn_is_not_claimed_and_the_form_is_right() {
        let Some(session) = Session::new("plain-cup-2poses") else {
            return;
        };
        let made = session.found();
        assert_eq!(made.code, Some(0), "{}", made.words);
        assert_eq!(made.report["verdict"]["level"], "amber", "{}", made.words);
        let second = &made.captures()[1];
        assert_eq!(second["held_by"], "nothing", "{second}");
        let told = second["words"].as_str().unwrap();
        let turn = "its turn about the axis cannot be known";
        assert!(told.contains(turn), "{told}");
        for error in session.errors(&made, false) {
            assert!(error.form_mm <= 0.25, "{error:?}");
        }
        // It is no worse than that of one capture.
        let (two, one) = (made.scores(), session.of_first(1));
        let least = one.scores().f_at_1_mm - 0.005;
        assert!(two.f_at_1_mm >= least, "{two:?}, {:?}", one.scores);
    }

    #[test]
    fn what_is_not_one_object_is_refused_by_name() {
        let Some(session) = Session::new("not-one-object") else {
            return;
        };
        let made = session.found();
        assert_eq!(made.code, Some(1), "{}", made.words);
        assert!(made.scores.is_none(), "{}", made.words);
        let second = &made.captures()[1];
        assert_eq!(second["refused"], "no_pose", "{second}");
        let name = format!("{}: ", session.captures[1]);
        assert!(made.words.contains(&name), "{}", made.words);
    }
}
