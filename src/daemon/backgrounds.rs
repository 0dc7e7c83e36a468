//! Backgrounds of the empty rig: saves them, and finds the newest after a restart. Each set is a recording of its own,
//! and none is ever deleted.

use super::names;
use crate::frame::{CameraId, Picture, Timestamp};
use crate::log;
use crate::recording::{ColorPart, Compression, Error, Recording, Topic, Writer};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Each colour camera's view of the rig with no object in it, and when it was taken.
pub(super) type Backgrounds = BTreeMap<CameraId, (Timestamp, Picture)>;

/// The folder of backgrounds beside the recordings.
fn folder(recordings: &Path) -> PathBuf {
    recordings.join("plates")
}

/// Saves backgrounds durably.
///
/// # Errors
/// If they cannot be written.
pub(super) fn save(
    recordings: &Path,
    now: Timestamp,
    backgrounds: &Backgrounds,
    program: &str,
) -> Result<PathBuf, Error> {
    let folder = folder(recordings);
    std::fs::create_dir_all(&folder).map_err(|cause| Error::Io {
        path: folder.clone(),
        cause,
    })?;
    let path = folder.join(format!("{}.mcap", names::free(&folder, now)));
    let mut writer = Writer::create(&path, program, Compression::None)?;
    for (id, (time, picture)) in backgrounds {
        writer.background(id, picture, *time)?;
    }
    writer.finish()?;
    Ok(path)
}

/// Copies backgrounds out of the pool, whose memory is for captures.
pub(super) fn detached(backgrounds: Backgrounds) -> Backgrounds {
    let own = |picture: Picture| match picture {
        Picture::Raw {
            width,
            height,
            encoding,
            step,
            data,
        } => Picture::Raw {
            width,
            height,
            encoding,
            step,
            data: data.to_vec().into(),
        },
        Picture::Compressed { format, data } => Picture::Compressed {
            format,
            data: data.to_vec().into(),
        },
    };
    let each = |(id, (time, picture))| (id, (time, own(picture)));
    backgrounds.into_iter().map(each).collect()
}

/// The newest background of each of these cameras. Empty if there is none or its file is unreadable (logged).
/// Backgrounds dated in the future (the clock was wrong) are used only as a last resort.
pub(super) fn newest(recordings: &Path, cameras: &[CameraId], now: Timestamp) -> Backgrounds {
    let mut backgrounds = until(recordings, cameras, now);
    let found = backgrounds.len();
    for (id, background) in until(recordings, cameras, Timestamp(u64::MAX)) {
        backgrounds.entry(id).or_insert(background);
    }
    if backgrounds.len() > found {
        log::warning!(
            "the backgrounds are dated in the future, {}: the clock was wrong when they were taken; take them again",
            names::of_time(
                backgrounds
                    .values()
                    .map(|(time, _)| *time)
                    .max()
                    .unwrap_or(now)
            )
        );
    }
    backgrounds
}

fn until(recordings: &Path, cameras: &[CameraId], end: Timestamp) -> Backgrounds {
    let mut backgrounds = Backgrounds::new();
    let files = std::fs::read_dir(folder(recordings)).into_iter().flatten();
    let mut files: Vec<PathBuf> = files.flatten().map(|f| f.path()).collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "mcap"));
    // Without their ending, before which a number sorts.
    files.sort_by_key(|f| f.with_extension(""));
    for file in files.iter().rev() {
        if cameras.iter().all(|id| backgrounds.contains_key(id)) {
            break;
        }
        if let Err(error) = add(file, cameras, end, &mut backgrounds) {
            log::warning!("{error}");
        }
    }
    backgrounds
}

fn add(
    file: &Path,
    cameras: &[CameraId],
    end: Timestamp,
    backgrounds: &mut Backgrounds,
) -> Result<(), Error> {
    let recording = Recording::open(file)?;
    for id in cameras {
        let topic = Topic::Color(id.clone(), ColorPart::Background);
        if backgrounds.contains_key(id) {
            continue;
        }
        let mut messages = recording.messages(&topic).iter();
        if let Some(message) = messages.rfind(|message| message.log_time() <= end) {
            let picture = recording.picture(&topic, message)?;
            backgrounds.insert(id.clone(), (message.log_time(), picture));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backgrounds_of_a_clock_that_was_ahead_serve_where_there_are_no_others() {
        let folder = tempfile::tempdir().unwrap();
        let at = |hours: u64| Timestamp(hours * 3_600_000_000_000);
        let camera = CameraId::new("c00").unwrap();
        let save = |hours| {
            let picture = Picture::Raw {
                width: 1,
                height: 1,
                encoding: "mono8".into(),
                step: 1,
                data: vec![hours as u8].into(),
            };
            let backgrounds = Backgrounds::from([(camera.clone(), (at(hours), picture))]);
            super::save(folder.path(), at(hours), &backgrounds, "test").unwrap();
        };
        let found = |now| newest(folder.path(), std::slice::from_ref(&camera), at(now))[&camera].0;
        save(10);
        assert_eq!(found(8), at(10), "there are no others");
        save(7);
        assert_eq!(found(8), at(7));
        assert_eq!(found(11), at(10));
    }
}
