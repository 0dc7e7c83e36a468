//! The reasons that pictures give which show the board elsewhere than other pictures of their placement do. They were
//! left out, so residuals show nothing of them; but something happened that may have happened elsewhere unnoticed.

use super::diagnosis::Finding;
use super::reason::{Reason, ReasonKind};
use super::result::{Fit, LeftOut};
use crate::calibration::CalibrationLevel;
use std::collections::BTreeMap;

/// Part of its distance by which a board that is held still may move while the cameras take their pictures. A picture
/// that shows it farther off is of another moment or another camera.
const HELD_STILL: f64 = 0.03;
/// Most placements that a reason names.
const MOST_NAMED: usize = 5;

/// Pictures that were left out for the same reason.
#[derive(Default)]
struct Contradiction<'a> {
    placements: Vec<&'a str>,
    /// The largest of what they are apart, over the distance.
    apart: f64,
}

impl<'a> Contradiction<'a> {
    fn add(&mut self, placement: &'a str, apart: f64) {
        self.placements.push(placement);
        self.apart = self.apart.max(apart);
    }

    /// The placements' names, and how many more there are.
    fn names(&self) -> String {
        let (named, more) = self
            .placements
            .split_at(self.placements.len().min(MOST_NAMED));
        match more.len() {
            0 => named.join(", "),
            count => format!("{} and {count} more", named.join(", ")),
        }
    }

    fn reason(&self, subject: &str, left_out: &str) -> Reason {
        let percent = 100.0 * self.apart;
        let (level, cause) = match self.apart > HELD_STILL {
            true => (
                CalibrationLevel::Doubtful,
                "a picture may be of another moment or another camera, and others may be too",
            ),
            false => (
                CalibrationLevel::Accepted,
                "the board or a camera may have moved, or a picture is of another moment",
            ),
        };
        let words = format!(
            "{subject}, by {percent:.1} % of the board's distance, so {left_out} used: {cause}; show the board there again"
        );
        Reason::new(level, ReasonKind::Contradiction, words)
    }
}

/// What views that were left out contradict, unless a finding about one of their cameras explains it: one reason for
/// whole placements, of which no view is known to be right, and one for each camera that the others outvoted.
pub(super) fn contradictions(fit: &Fit, findings: &[Finding]) -> Vec<Reason> {
    let is_explained = |left_out: &LeftOut| {
        let mut of_findings = findings.iter().flat_map(|finding| &finding.cameras);
        of_findings.any(|id| left_out.views.contains(id))
    };
    let mut placements = Contradiction::default();
    let mut cameras: BTreeMap<&str, Contradiction> = BTreeMap::new();
    for left_out in fit.left_out.iter().filter(|l| !is_explained(l)) {
        let (Some(name), Some(apart)) = (&left_out.placement, left_out.apart) else {
            continue;
        };
        match &left_out.camera {
            Some(id) => cameras.entry(id.as_str()).or_default().add(name, apart),
            None => placements.add(name, apart),
        }
    }
    let mut found = Vec::new();
    if !placements.placements.is_empty() {
        let subject = format!(
            "the pictures of {} contradict each other",
            placements.names()
        );
        found.push(placements.reason(&subject, "none of them is"));
    }
    found.extend(cameras.iter().map(|(id, own)| {
        let names = own.names();
        let subject =
            format!("camera {id}: what it shows at {names} contradicts the other cameras");
        own.reason(&subject, "it is not")
    }));
    found
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::{Random, Truth, color_lens, looking, placements};
    use super::super::{Parameters, fit};
    use super::*;
    use crate::calibration::Board;
    use crate::frame::CameraId;
    use nalgebra::Point3;

    fn id(name: &str) -> CameraId {
        CameraId::new(name).unwrap()
    }

    /// A fit that left this out: of one camera at a placement, or all of it.
    fn with(left_out: &[(Option<&str>, &str, f64)]) -> Fit {
        let board = Board::checkerboard(6, 5, 0.035).unwrap();
        let camera = |i: usize| {
            let from = Point3::new(0.2 * i as f64 - 0.2, -0.3, 0.75);
            looking(
                &format!("c{i:02}"),
                color_lens(),
                from,
                Point3::new(0.0, 0.0, 0.1),
            )
        };
        let shown = placements(&board, 6, &mut Random(1));
        let truth = Truth::new(board, (0..3).map(camera).collect(), shown);
        let parameters = Parameters {
            folds: 0,
            ..Parameters::default()
        };
        let mut fit = fit(&truth.session(0.1, &mut Random(7)), &parameters).unwrap();
        let omission = |&(camera, placement, apart): &(Option<&str>, &str, f64)| LeftOut {
            camera: camera.map(id),
            placement: Some(placement.to_owned()),
            reason: String::new(),
            views: camera.map_or_else(|| vec![id("c00"), id("c01")], |camera| vec![id(camera)]),
            apart: Some(apart),
        };
        fit.left_out = left_out.iter().map(omission).collect();
        fit
    }

    #[test]
    fn pictures_that_contradict_each_other_are_never_noise() {
        assert_eq!(contradictions(&with(&[]), &[]), []);
        let pair = with(&[(None, "p05", 0.23), (None, "p07", 0.01)]);
        let [reason] = &contradictions(&pair, &[])[..] else {
            panic!("one reason")
        };
        assert_eq!(reason.level, CalibrationLevel::Doubtful);
        let told = "the pictures of p05, p07 contradict each other, by 23.0 % of the board's distance, so none of them is \
                    used: a picture may be of another moment or another camera";
        assert!(reason.words.starts_with(told), "{}", reason.words);
        let outvoted = [("p01", 0.01), ("p02", 0.02)].map(|(p, apart)| (Some("c01"), p, apart));
        let [reason] = &contradictions(&with(&outvoted), &[])[..] else {
            panic!("one reason")
        };
        assert_eq!(reason.level, CalibrationLevel::Accepted);
        let told = "camera c01: what it shows at p01, p02 contradicts the other cameras, by 2.0 % of the board's distance, \
                    so it is not used: the board or a camera may have moved";
        assert!(reason.words.starts_with(told), "{}", reason.words);
        // What a finding says is not said twice.
        let finding = Finding {
            cameras: vec![id("c01")],
            words: "camera c01 moved".into(),
        };
        assert_eq!(contradictions(&pair, &[finding]), []);
    }
}
