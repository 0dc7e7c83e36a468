//! Refuses a configuration that gives one device two names: one of them could never be opened, or each would get the
//! other's pictures.

use crate::drivers::{aravis, openni2, v4l2};
use crate::frame::CameraId;
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::path::Path;

type Cameras<P> = BTreeMap<CameraId, P>;

/// # Errors
/// If two cameras have one address, serial number or name.
pub(super) fn check_unique_gige(cameras: &Cameras<aravis::Parameters>) -> Result<(), String> {
    check_unique("aravis", "address", cameras, |p| p.address)?;
    check_unique("aravis", "serial", cameras, |p| p.serial.as_deref())?;
    check_unique("aravis", "name", cameras, |p| p.name.as_deref())
}

/// # Errors
/// If two cameras have one device, by its path or where their paths lead to.
pub(super) fn check_unique_v4l2(cameras: &Cameras<v4l2::Parameters>) -> Result<(), String> {
    check_unique("v4l2", "device", cameras, |p| Some(p.device()))?;
    let mut taken = BTreeMap::new();
    for (id, parameters) in cameras {
        let device = parameters.device();
        // One that is not there leads nowhere yet.
        let Ok(leads_to) = Path::new(device).canonicalize() else {
            continue;
        };
        if let Some((other, theirs)) = taken.insert(leads_to.clone(), (id, device)) {
            return Err(format!(
                "v4l2.cameras.{id}: device {device:?} is already used by {other}: it and \
                {theirs:?} are {}",
                leads_to.display()
            ));
        }
    }
    Ok(())
}

/// # Errors
/// If two cameras have one device, or one takes any where there is another.
pub(super) fn check_unique_openni2(cameras: &Cameras<openni2::Parameters>) -> Result<(), String> {
    let own =
        |words: String| format!("{words}, expected a serial number, a URI or a file of its own");
    check_unique("openni2", "device", cameras, |p| Some(p.device())).map_err(own)?;
    // The first device that is free may be the other camera's. A file is nobody else's.
    let live = || cameras.iter().filter(|(_, p)| !p.is_file());
    let any = live().find(|(_, p)| p.device() == "any");
    let other = live().find(|(_, p)| p.device() != "any");
    match (any, other) {
        (Some((id, _)), Some((other, theirs))) => Err(own(format!(
            "openni2.cameras.{id}: device \"any\" may take {:?}, which is that of {other}",
            theirs.device()
        ))),
        _ => Ok(()),
    }
}

fn check_unique<'a, P, V: Ord + Debug>(
    driver: &str,
    field: &str,
    cameras: &'a Cameras<P>,
    value: impl Fn(&'a P) -> Option<V>,
) -> Result<(), String> {
    let mut taken = BTreeMap::new();
    for (id, parameters) in cameras {
        let Some(value) = value(parameters) else {
            continue;
        };
        if let Some(other) = taken.get(&value) {
            return Err(format!(
                "{driver}.cameras.{id}: {field} {value:?} is already used by {other}"
            ));
        }
        taken.insert(value, id);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::de::DeserializeOwned;

    fn cameras<P: DeserializeOwned>(text: &str) -> Cameras<P> {
        let named: BTreeMap<String, P> = toml::from_str(text).unwrap();
        let named = named.into_iter();
        named
            .map(|(name, p)| (CameraId::new(&name).unwrap(), p))
            .collect()
    }

    #[test]
    fn gige_cameras_are_told_apart_by_each_field_that_they_have() {
        let sound = "c00 = { serial = 'a', name = 'b' }\nc01 = { serial = 'b', name = 'a' }\n\
                     c02 = { address = '10.0.0.2' }";
        assert_eq!(check_unique_gige(&cameras(sound)), Ok(()));
        for (field, value, shown) in [
            ("address", "10.0.0.7", "10.0.0.7"),
            ("serial", "217", "\"217\""),
            ("name", "left", "\"left\""),
        ] {
            let text = format!(
                "a = {{ {field} = '{value}' }}\nb = {{ serial = 'b' }}\nc = {{ {field} = '{value}' }}"
            );
            assert_eq!(
                check_unique_gige(&cameras(&text)).unwrap_err(),
                format!("aravis.cameras.c: {field} {shown} is already used by a")
            );
        }
    }

    #[test]
    fn v4l2_cameras_are_told_apart_by_their_paths_and_where_they_lead() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).display().to_string();
        for device in ["video0", "video1"] {
            std::fs::write(path(device), "").unwrap();
        }
        for (link, device) in [("id-0", "video0"), ("path-0", "video0"), ("id-1", "video1")] {
            std::os::unix::fs::symlink(device, path(link)).unwrap();
        }
        let of = |devices: [&str; 2]| {
            let [a, b] = devices.map(path);
            check_unique_v4l2(&cameras(&format!(
                "a = {{ device = '{a}' }}\nb = {{ device = '{b}' }}"
            )))
        };
        assert_eq!(of(["id-0", "id-1"]), Ok(()));
        assert_eq!(of(["none-0", "none-1"]), Ok(()));
        assert_eq!(
            of(["none-0", "none-0"]).unwrap_err(),
            format!(
                "v4l2.cameras.b: device {:?} is already used by a",
                path("none-0")
            )
        );
        let words = of(["id-0", "path-0"]).unwrap_err();
        for named in ["cameras.b: device", "path-0", "used by a", "id-0", "video0"] {
            assert!(words.contains(named), "{named}: {words}");
        }
    }

    #[test]
    fn depth_cameras_are_told_apart_by_their_devices_and_one_alone_may_be_any() {
        for sound in [
            "a = {}",
            "a = { device = '1d27/0601@3/7' }\nb = { device = 'x1' }",
            "a = { device = '/data/cup.oni' }\nb = {}",
        ] {
            assert_eq!(check_unique_openni2(&cameras(sound)), Ok(()), "{sound}");
        }
        for (text, named) in [
            (
                "a = {}\nb = { device = 'any' }",
                "device \"any\" is already used by a",
            ),
            (
                "a = { device = 'x1' }\nb = {}",
                "device \"any\" may take \"x1\", which is that of a, expected",
            ),
            (
                "a = { device = 'x1' }\nb = { device = 'x1' }",
                "device \"x1\" is already used by a",
            ),
        ] {
            let words = check_unique_openni2(&cameras(text)).unwrap_err();
            assert!(
                words.contains(named) && words.contains("openni2.cameras.b"),
                "{words}"
            );
        }
    }
}
