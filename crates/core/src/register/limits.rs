//! The limits by which poses are accepted or refused, all in one place. `design/fusion.md` has the measurements that
//! they come from.

use super::ColorAgreement;

/// Own noise beyond this many metres, or beyond [`OWN_PX`], is a contradiction.
const OWN: f64 = 0.15e-3;
/// Pixels of the same.
const OWN_PX: f64 = 0.4;
/// A pose is accepted up to this many times the own noise …
const ACCEPTED: f64 = 1.8;
/// … or this many pixels more than it, where it is tiny: one stretch that its own limit bears may make so much.
const ACCEPTED_MORE_PX: f64 = 0.12;
/// The lower half of the gap, in which a pose is green.
const GREEN: f64 = 1.6;
/// Silhouettes object to a pose from this many times the own noise on.
const OBJECTION: f64 = 2.0;
/// Pixels of the same, where the noise is tiny.
const OBJECTION_MORE_PX: f64 = 0.12;
/// All other captures together may say so many times the own noise against one: the more cones, the more of them err …
const ALL_AT_ONCE: f64 = 2.5;
/// … or so many pixels more than it.
const ALL_AT_ONCE_MORE_PX: f64 = 0.2;
/// In the lower half of that, it says so many times the own noise at most …
const AT_ONCE_GREEN: f64 = 2.0;
/// … or so many pixels more than it.
const AT_ONCE_GREEN_MORE_PX: f64 = 0.16;
/// A stretch of contour may miss what its own capture leaves by so many square pixels, length by depth …
const OWN_STRETCH_PX2: f64 = 120.0;
/// … and what another capture leaves by so many more than that …
const STRETCH_PX2: f64 = 95.0;
/// … of either so many where the pose is green.
const GREEN_STRETCH_PX2: f64 = 85.0;
/// At one spot, what several views of a capture miss beyond their own noise may weigh so many square pixels, without
/// the view that misses most …
const SPOT_PX2: f64 = 60.0;
/// … and so many where the pose is green.
const SPOT_GREEN_PX2: f64 = 40.0;
/// What one outline alone denies the rays of several views, off the tables, may weigh so many square pixels, without
/// the view that misses most …
const LOST_PX2: f64 = 14.0;
/// … and so many where the pose is green.
const LOST_GREEN_PX2: f64 = 8.0;
/// Metres that a pixel covers on an object from which on these areas are those. Where pixels are smaller, as at 5
/// megapixels, outlines err over as many millimetres, which are more pixels.
const AREA_PIXEL: f64 = 0.33e-3;
/// A stretch against a pose that was not fitted may weigh so many times as much …
const STRETCH_OBJECTION: f64 = 1.5;
/// … and all other captures together may say so many times as much against it.
const AT_ONCE_OBJECTION: f64 = 1.5;
/// Comparisons of two captures that are made at most: so many for each capture …
const COMPARISONS_EACH: usize = 2;
/// … and so many more. All of up to six captures can be compared.
const COMPARISONS_MORE: usize = 12;

/// Poses that move the surface by more than this share of its radius differ.
pub(super) const APART: f64 = 0.13;
/// Poses that move it by less are one.
pub(super) const SAME: f64 = 0.025;
/// Free turns that are compared: those of a body of revolution upright and upside-down, and their like.
pub(super) const MOST_TURNS: usize = 2;

/// Colours decide from this correlation on …
const CORRELATION: f64 = 0.35;
/// … if it is larger than any other pose's by this.
const CORRELATION_MARGIN: f64 = 0.12;
/// Colours tell no pose from another where they correlate by more than this at each …
const ALIKE: f64 = 0.7;
/// … by less than this more at the best than at the worst …
const ALIKE_SPREAD: f64 = 0.06;
/// … and lack at the worst at most so many times what they lack at the best, which is their noise …
const ALIKE_NOISE: f64 = 1.6;
/// … and this. Rings alone lack up to 1.55 times as much.
const ALIKE_MORE: f64 = 0.01;
/// They tell one where the best is above the median by more than so many standard deviations of the noise, and a
/// little. Rings alone reach 2.2, a spot of 10 mm on a body of 29 mm 3.7.
const PEAK_DEVIATIONS: f64 = 2.8;
const PEAK: f64 = 0.003;
/// Contrast of the logarithm of brightness below which a surface is plain.
pub(super) const PLAIN: f64 = 0.06;
/// Contrast from which on it surely has a pattern; a plain mug's own shadows reach 0.12.
const PATTERN: f64 = 0.15;
/// Patterns that correlate by less than this have nothing in common …
const NOTHING_IN_COMMON: f64 = 0.1;
/// … if they are compared at so many points at least.
const COMMON_POINTS: usize = 500;

/// Share of depth readings beyond which they contradict a pose.
pub(super) const DEPTH_CONTRADICTS: f64 = 0.03;
/// Depth tells no turn from another where it objects to fewer of them than this share …
pub(super) const DEPTH_OBJECTS_TO: f64 = 0.4;
/// … and to no more in a row than these degrees. For an object that fits again after a quarter of a turn, it objects
/// to more.
pub(super) const DEPTH_OBJECTS_IN_A_ROW_DEG: f64 = 45.0;
/// A part of a free turn that depth finds equally good is wide from these degrees on: it claims no turn.
pub(super) const DEPTH_WIDE_DEG: f64 = 75.0;
/// Poses that depth finds equally good may differ by this share of the radius and still count as one …
pub(super) const DEPTH_SPREAD: f64 = 0.12;
/// … if their turns lie within so many degrees of their middle.
pub(super) const DEPTH_SIGMA_DEG: f64 = 2.0;

/// Whether colours choose the pose at which they agree best.
pub(super) fn do_colours_decide(colours: &ColorAgreement) -> bool {
    colours.best > CORRELATION && is_outdone(colours.next, colours.best)
}

/// Whether colours decide against a pose at which they correlate by `rated`, because of one where they do by `best`.
pub(super) fn is_outdone(rated: f64, best: f64) -> bool {
    best - rated > CORRELATION_MARGIN
}

/// Whether colours agree at several poses, and at none better than at another but for their noise: by `best` and
/// `least`.
pub(super) fn are_colours_alike(best: f64, least: f64) -> bool {
    least > ALIKE
        && best - least < ALIKE_SPREAD
        && 1.0 - least < ALIKE_NOISE * (1.0 - best) + ALIKE_MORE
}

/// Whether the best correlation is so far above the median that noise does not explain it.
pub(super) fn is_peak(above: f64, noise: f64) -> bool {
    above > PEAK_DEVIATIONS * noise + PEAK
}

/// Whether colours were compared at so many points that they can be called alike.
pub(super) fn are_compared(colours: &ColorAgreement) -> bool {
    colours.points >= COMMON_POINTS
}

/// Whether both captures show a pattern, and the patterns have nothing in common.
pub(super) fn do_colours_contradict(colours: &ColorAgreement) -> bool {
    colours.contrast >= PATTERN
        && colours.points >= COMMON_POINTS
        && colours.best < NOTHING_IN_COMMON
}

/// Whether a surface that is not plain confirms a turn which silhouettes leave open.
pub(super) fn do_colours_confirm(colours: &ColorAgreement) -> bool {
    colours.contrast >= PLAIN && do_colours_decide(colours)
}

/// Whether both captures surely show a pattern, and it does not confirm such a turn.
pub(super) fn do_colours_leave_open(colours: &ColorAgreement) -> bool {
    colours.contrast >= PATTERN && colours.points >= COMMON_POINTS && !do_colours_decide(colours)
}

/// The most own noise that a capture may have, in metres.
pub(super) fn own(pixel: f64) -> f64 {
    OWN.max(OWN_PX * pixel)
}

/// The most disagreement of a pose that is accepted, in metres.
pub(super) fn accepted(noise: f64, pixel: f64) -> f64 {
    (ACCEPTED * noise)
        .max(noise + ACCEPTED_MORE_PX * pixel)
        .min(1.2 * own(pixel))
}

/// Whether a pose's disagreement lies in the lower half of what is accepted.
pub(super) fn is_green(disagreement: f64, noise: f64, pixel: f64) -> bool {
    disagreement <= (GREEN * noise).max(noise + 0.8 * ACCEPTED_MORE_PX * pixel)
}

/// The disagreement from which on silhouettes object, in metres.
pub(super) fn objection(noise: f64, pixel: f64) -> f64 {
    (OBJECTION * noise).max(noise + OBJECTION_MORE_PX * pixel)
}

/// A limit of square pixels for pixels that cover `pixel` metres.
fn area(square_pixels: f64, pixel: f64) -> f64 {
    square_pixels * (AREA_PIXEL / pixel).max(1.0).powi(2)
}

/// Whether a stretch of contour of this weight in square pixels contradicts the other contours of its own capture.
pub(super) fn does_contradict_itself(stretch: f64, pixel: f64) -> bool {
    stretch > area(OWN_STRETCH_PX2, pixel)
}

/// Whether what a stretch of contour misses beyond that, in square pixels, contradicts another capture.
pub(super) fn is_long(stretch: f64, pixel: f64) -> bool {
    stretch > area(STRETCH_PX2, pixel)
}

/// Whether a stretch of either kind is so long that a person should look.
pub(super) fn is_doubtful(stretch: f64, pixel: f64) -> bool {
    stretch > area(GREEN_STRETCH_PX2, pixel)
}

/// Whether what several views say of one spot, in square pixels, shows that the object changed there.
pub(super) fn is_change(spot: f64, pixel: f64) -> bool {
    spot > area(SPOT_PX2, pixel)
}

/// Whether it lies above the lower half of what is accepted.
pub(super) fn is_maybe_change(spot: f64, pixel: f64) -> bool {
    spot > area(SPOT_GREEN_PX2, pixel)
}

/// Whether what one outline alone denies several views, in square pixels, shows that it lost a piece.
pub(super) fn is_lost_piece(weight: f64, pixel: f64) -> bool {
    weight > area(LOST_PX2, pixel)
}

/// Whether it lies above the lower half of what is accepted.
pub(super) fn is_maybe_lost_piece(weight: f64, pixel: f64) -> bool {
    weight > area(LOST_GREEN_PX2, pixel)
}

/// Whether a stretch objects to a pose that was not fitted to the silhouettes.
pub(super) fn does_stretch_object(stretch: f64, pixel: f64) -> bool {
    is_long(stretch / STRETCH_OBJECTION, pixel)
}

/// How many comparisons of two captures are made at most, of so many captures.
pub(super) fn comparisons(captures: usize) -> usize {
    COMPARISONS_EACH * captures + COMPARISONS_MORE
}

/// The most contradicting share that is borne where the least of any turn is known.
pub(super) fn depth(least: f64) -> f64 {
    2.0 * least + 0.01
}

/// The most that all other captures may say against one, in metres.
pub(super) fn all_at_once(noise: f64, pixel: f64) -> f64 {
    (ALL_AT_ONCE * noise).max(noise + ALL_AT_ONCE_MORE_PX * pixel)
}

/// The most that they may say against one whose pose was not fitted to the silhouettes, in metres.
pub(super) fn at_once_objection(noise: f64, pixel: f64) -> f64 {
    AT_ONCE_OBJECTION * all_at_once(noise, pixel)
}

/// Whether what all others say lies in the lower half of what they may say of a pose that was fitted.
pub(super) fn is_green_at_once(rms: f64, noise: f64, pixel: f64) -> bool {
    rms <= (AT_ONCE_GREEN * noise).max(noise + AT_ONCE_GREEN_MORE_PX * pixel)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas_are_of_pixels_or_where_these_are_small_of_millimetres() {
        for pixel in [0.33e-3, 0.36e-3, 1e-3] {
            assert!(is_long(96.0, pixel) && !is_long(94.0, pixel));
        }
        // Half as wide: what was one pixel is four.
        assert!(is_long(4.0 * 96.0, 0.165e-3) && !is_long(4.0 * 94.0, 0.165e-3));
        assert!(is_change(4.0 * 61.0, 0.165e-3) && !is_change(4.0 * 59.0, 0.165e-3));
    }
}
