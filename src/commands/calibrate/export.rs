//! `scand calibrate --from`: writes an existing calibration in the formats of ROS and Kalibr.

use super::bad_file;
use super::files::FileArgs;
use crate::calibrate;
use crate::storage::write_atomically;
use crate::words::count;
use std::path::Path;
use std::process::ExitCode;

/// Writes the calibration of `from` to the files that are asked for.
pub(super) fn run(
    from: &Path,
    out: Option<&Path>,
    files: &FileArgs,
    force: bool,
    quiet: bool,
) -> anyhow::Result<ExitCode> {
    anyhow::ensure!(
        out.is_some() || files.exports(),
        "--from {}: also give --ros, --kalibr or --out for the result",
        from.display()
    );
    let calibration = calibrate::load(from).map_err(bad_file)?;
    files.refuse_to_replace(calibration.cameras.keys(), force)?;
    if let Some(path) = out {
        write_atomically(path, calibration.to_toml().as_bytes())?;
    }
    files.write_exports(&calibration)?;
    if !quiet {
        let cameras = count(calibration.cameras.len(), "camera");
        outln!("{}: {cameras}", from.display());
    }
    Ok(ExitCode::SUCCESS)
}
