//! Checks and adapts a configuration to cameras that an electrical signal triggers.

use crate::config::Config;
use crate::drivers::live::LINE_LEAD;
use crate::drivers::{aravis, v4l2};

/// Adapts a configuration to cameras that a signal triggers. Their exposure begins before the daemon hears of the
/// trigger, so the tolerance must be at least that long. Failed captures are not retried, because no second signal
/// would come.
///
/// # Errors
/// If frames of such a camera would be taken for those of an earlier press.
pub(super) fn allow_for_lines(config: &mut Config) -> Result<(), String> {
    let cameras = triggered_by_lines(config)?;
    if cameras.is_empty() {
        return Ok(());
    }
    let least = LINE_LEAD.as_secs_f64() * 1e3;
    let found = config.sync.tolerance_ms;
    if found < least {
        return Err(format!(
            "sync.tolerance_ms is {found}, expected at least {least} if a line triggers cameras ({}): their exposure begins before \
             the daemon hears of the trigger",
            cameras.join(", ")
        ));
    }
    config.capture.retry = 0;
    Ok(())
}

fn triggered_by_lines(config: &Config) -> Result<Vec<String>, String> {
    let gige = config.aravis.each()?.into_iter();
    let gige = gige.filter(|(_, p)| p.trigger_mode() == aravis::TriggerMode::Line);
    let kernel = config.v4l2.each()?.into_iter();
    let kernel = kernel.filter(|(_, p)| p.trigger() == v4l2::TriggerMode::Line);
    let cameras = gige.map(|(id, _)| id).chain(kernel.map(|(id, _)| id));
    Ok(cameras.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: &str = "[aravis.cameras.c07]\naddress = '192.168.7.7'\n";

    fn allowed(text: &str) -> Result<Config, String> {
        let mut config: Config = toml::from_str(text).unwrap();
        allow_for_lines(&mut config).map(|()| config)
    }

    #[test]
    fn a_line_wants_a_tolerance_and_no_retry() {
        let plain = allowed(CAMERA).unwrap();
        assert_eq!(plain.capture.retry, Config::default().capture.retry);
        let line = format!("{CAMERA}trigger = 'line'\n");
        let refused = allowed(&line).unwrap_err();
        assert!(
            refused.contains("sync.tolerance_ms is 5, expected at least 50")
                && refused.contains("(c07)"),
            "{refused}"
        );
        let wide = allowed(&format!("{line}[sync]\ntolerance_ms = 50.0\n")).unwrap();
        assert_eq!(wide.capture.retry, 0);
        let kernel = "[v4l2.cameras.c03]\ndevice = '/dev/video3'\ntrigger = 'line'\n";
        assert!(allowed(kernel).unwrap_err().contains("(c03)"));
    }
}
