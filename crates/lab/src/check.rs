//! Checks the options before anything is rendered: refuses numbers out of range, and faults of cameras that the rig
//! does not have.

use super::{Error, Options, Rig, invalid, within_range};

/// Refuses numbers that make no session.
pub(super) fn check(options: &Options) -> Result<(), Error> {
    let (color, depth) = (&options.color, &options.depth);
    // The second depth camera looks at 35 degrees more, and none may look up.
    let most_slant = if options.depth_cameras > 1 {
        50.0
    } else {
        85.0
    };
    let within = [
        ("spacing", options.spacing_mm, [0.1, 50.0], " mm"),
        (
            "depth slant",
            options.depth_slant_deg,
            [0.0, most_slant],
            " degrees",
        ),
        ("depth distance", options.depth_distance, [0.4, 3.0], " m"),
        ("JPEG quality", color.jpeg_quality.into(), [1.0, 100.0], ""),
        (
            "JPEG quality of the depth camera's colour",
            depth.color_jpeg_quality.into(),
            [0.0, 100.0],
            " (0 is rgb8)",
        ),
        ("full well", color.full_well, [0.0, 1e9], " electrons"),
        ("read noise", color.read_noise, [0.0, 1e6], " electrons"),
        ("blur", color.blur_px, [0.0, 4.0], " px"),
        ("exposure drift", color.exposure_drift, [0.0, 0.3], ""),
        ("shadows", color.shadows, [0.0, 1.0], ""),
        ("spill", color.spill, [0.0, 1.0], ""),
        ("depth smear", depth.smear_px, [0.0, 9.0], " px"),
        ("depth bias", depth.bias_mm, [-200.0, 200.0], " mm"),
        (
            "depth bias of the object",
            depth.object_bias_mm,
            [-200.0, 200.0],
            " mm",
        ),
        (
            "calibration error",
            options.faults.calibration_px,
            [0.0, 10.0],
            " px",
        ),
        (
            "calibration's scale",
            options.faults.calibration_scale_percent,
            [-10.0, 10.0],
            " per cent",
        ),
        (
            "misregistration",
            depth.misregistration_px,
            [-50.0, 50.0],
            " px",
        ),
    ];
    for (what, found, range, unit) in within {
        within_range(what, found, range, unit)?;
    }
    match options.low_cameras {
        Some(low) if low > options.cameras => Err(invalid(
            "low cameras",
            low,
            format!("at most {}, the number of colour cameras", options.cameras),
        )),
        _ => Ok(()),
    }
}

/// Refuses a session that no model can be made of.
pub(super) fn check_counts(options: &Options) -> Result<(), Error> {
    if options.cameras < 2 {
        return Err(invalid("cameras", options.cameras, "2 to 99"));
    }
    if options.captures == 0 {
        return Err(invalid("captures", options.captures, "at least 1"));
    }
    Ok(())
}

/// Refuses faults of cameras that are not there, or that cannot have them.
pub(super) fn check_faults(options: &Options, rig: &Rig) -> Result<(), Error> {
    let colors = rig.colors.iter().map(|s| s.actual.id.as_str());
    let depths = rig.depths.iter().map(|s| s.actual.camera.id.as_str());
    let depths: Vec<&str> = depths.collect();
    let known: Vec<&str> = colors.chain(depths.iter().copied()).collect();
    let faults = &options.faults;
    if let Some(name) = faults.cameras().find(|name| !known.contains(name)) {
        let expected = "the id of a camera of the rig";
        return Err(invalid("camera of a fault", name, expected));
    }
    let no_background = faults.no_background.iter().map(String::as_str);
    let without = no_background.map(|camera| ("camera without a background", camera));
    let of_colors = faults.of_colors().into_iter();
    let named = of_colors.flat_map(|(what, list)| list.iter().map(move |f| (what, &*f.camera)));
    match named
        .chain(without)
        .find(|(_, camera)| depths.contains(camera))
    {
        Some((what, camera)) => Err(invalid(
            what,
            format!("the depth camera {camera}"),
            "a colour camera: a depth camera may be missing or late",
        )),
        None => Ok(()),
    }
}
