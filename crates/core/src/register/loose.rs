//! A pose that the silhouettes hold loosely in one direction, such as that of a vessel that is nearly round: colours
//! are asked within some degrees of it. Where they do not tell, a person should look.

use super::align::Aligned;
use super::decide::{CapturePair, Decision};
use super::determination::Determination;
use super::limits;

/// Degrees to either side at which colours are compared.
const SIDE_DEG: i32 = 10;
/// Poses that are so many degrees from the best one should correlate less.
const APART_DEG: f64 = 3.0;

impl CapturePair<'_> {
    /// The pose near the best one that colours choose, or the best one as a doubtful one.
    pub(super) fn loosely_held(
        &self,
        stated: Decision,
        best: &Aligned,
        determination: &Determination,
    ) -> Decision {
        let (a, b) = (&self.a.body, &self.b.body);
        let poses = determination.near(a, b, best, SIDE_DEG, self.object);
        let apart = |x: &nalgebra::Isometry3<f64>, y: &nalgebra::Isometry3<f64>| {
            (x.inverse() * y).rotation.angle().to_degrees() > APART_DEG
        };
        let chosen = self.best_by_colours(&poses, &apart);
        if let Some((top, colours)) = chosen
            && limits::do_colours_decide(&colours)
            && colours.contrast >= limits::PLAIN
            // At an end of what silhouettes bear, a better pose may lie beyond.
            && (1..poses.len().saturating_sub(1)).contains(&top)
        {
            let mut asked = stated;
            asked.colours = Some(colours);
            return self.by_colours(asked, poses[top], true, f64::INFINITY);
        }
        let mut decision = self.unique(stated);
        decision.is_doubtful = true;
        // Any of these poses may be the right one.
        let widest = determination.slack_deg / 3.0_f64.sqrt();
        decision.uncertainty.0 = decision.uncertainty.0.max(widest);
        decision
    }
}
