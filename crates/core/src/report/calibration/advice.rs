//! What helps against each kind of reason why a calibration is not good.

use crate::calibration::fit::ReasonKind;

/// What to do, in whole sentences; empty where the reason says it itself.
pub(super) fn advice(kind: ReasonKind) -> &'static str {
    match kind {
        // Its words name the remedy.
        ReasonKind::Diagnosed | ReasonKind::Contradiction => "",
        ReasonKind::LeftOut => {
            "See what was left out, and why, below. A camera that moved or was refocused, exchanged cables, or pictures \
             of another moment do this: correct it, and show the board again."
        }
        ReasonKind::AtOnePlace => "Check the cameras' cables and names.",
        ReasonKind::Residual => {
            "Look at its arrows below. If they point in one direction, the camera or the board moved. If they form a whirl or \
             a star, try another lens model (--model rational). If they look like noise everywhere, the picture is blurred \
             or badly lit, or the board is not flat."
        }
        ReasonKind::BeyondLensModel => {
            "Try --model rational. No model reaches a fisheye lens: undistort its pictures first, or use another lens."
        }
        ReasonKind::GivenLens => {
            "Calibrate without --fix-intrinsics, or give the lens as it is now: of this focus, zoom and size of picture."
        }
        ReasonKind::DroppedCorners => {
            "Check that the board is flat and evenly lit, and that its picture is sharp."
        }
        ReasonKind::FewViews => "Show it the board more often, in different tilts.",
        ReasonKind::Coverage => "Hold the board into the corners of its picture too.",
        ReasonKind::FewPlacements => "Show the board in more places and tilts, twelve or so.",
        ReasonKind::SingleJoint => {
            "Show the board at four places or more where it and one of the other cameras see it at once."
        }
        ReasonKind::FocalLength => {
            "Show it the board more often, tilted by 30° and more to all sides, also in the corners of its picture."
        }
        ReasonKind::HeldOut => {
            "Add placements in other tilts and places; check that the board is flat and no lens moves."
        }
        ReasonKind::Bent => {
            "Glue the print to something flat and stiff: glass, or an aluminium composite."
        }
        ReasonKind::Stretched => {
            "Measure both rulers of the print; the mean of the two sets the scale."
        }
        ReasonKind::ShapeNotHeld => {
            "Show it once more, flat and at rest at each placement; glue the print to something stiff."
        }
        ReasonKind::NotCalibrated => {
            "Show it the board together with a neighbour, three times or more."
        }
        ReasonKind::TableUnknown => {
            "Put the board flat on the table once, or name the placement that lies there with --table-placement."
        }
        ReasonKind::Scale => {
            "Measure the board's squares over its whole length: the calibration's scale is theirs. Only then is it known \
             which of the two is wrong."
        }
        ReasonKind::NoResponse => {
            "Show it the board more often, tilted, from the nearest to the farthest distance that matters."
        }
        ReasonKind::DepthBias => {
            "Show it the board at more distances; check that the board is flat and that its picture is sharp."
        }
        ReasonKind::DepthUnknown => {
            "Show it the board at more places and tilts, together with other cameras: what is known least is where it is \
             itself."
        }
        ReasonKind::DepthLeftOut => {
            "See below which boards they are. Hold the board still until all cameras have seen it, and show it again."
        }
        ReasonKind::DepthChanged => {
            "It may still have been warming up, or its settings may have changed. Show the board again, or calibrate from the sound \
             part of the session alone."
        }
        ReasonKind::DepthMisregistered => {
            "Let the driver register depth and colour, and check that both streams have the size for which it does so."
        }
        ReasonKind::DepthBowl => {
            "Place objects near the middle of its picture: the calibration's file cannot hold a correction for each pixel."
        }
        ReasonKind::DepthNotLinear => {
            "Place objects at the distances at which little bias is left, below; show it the board at more distances."
        }
    }
}
