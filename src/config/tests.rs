//! Tests that configurations are read as they are meant, and that messages name file, line and field.

use super::*;

fn settings(all: &[&str]) -> Result<Config, Error> {
    Config::load(
        None,
        &all.iter().map(ToString::to_string).collect::<Vec<_>>(),
    )
}

#[test]
fn values_that_contradict_each_other_are_refused_by_both_names() {
    let message = settings(&["sync.depth_frames=5"]).unwrap_err().to_string();
    let words = "sync.min_depth_frames is 10, expected at most sync.depth_frames, which is 5";
    let begin = format!("--set sync.depth_frames=5: {words}");
    assert!(message.starts_with(&begin), "{message}");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("rig.toml");
    std::fs::write(&file, "[sync]\ndepth_frames = 5\n").unwrap();
    let message = Config::load(Some(&file), &[]).unwrap_err().to_string();
    assert!(
        message.contains("rig.toml: ") && message.contains(words),
        "{message}"
    );
    // Only what is set in the end has to agree.
    assert!(settings(&["sync.depth_frames=5", "sync.min_depth_frames=3"]).is_ok());
}

#[test]
fn single_values_are_set_over_the_defaults() {
    let config = settings(&[
        "hull.resolution=160",
        "method=depth-hull",
        "restoration.form=lid",
    ]);
    // An integer serves where a number is wanted.
    assert!(
        config.as_ref().is_ok_and(|c| c.hull.resolution == 160.0),
        "{config:?}"
    );
    assert_eq!(config.unwrap().method, reconstruct::Method::DepthHull);
}

#[test]
fn lengths_may_have_their_units() {
    for text in [
        "hull.cell_size=2mm",
        "hull.cell_size=0.2cm",
        "hull.cell_size=0.002",
    ] {
        assert_eq!(settings(&[text]).unwrap().hull.cell_size, 0.002, "{text}");
    }
    let inch = settings(&["verdict.unstated_uncertainty_mm=1in"]).unwrap();
    assert!((inch.verdict.unstated_uncertainty_mm - 25.4).abs() < 1e-9);
    assert!(settings(&["hull.resolution=many"]).is_err());
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lengths.toml");
    std::fs::write(
        &file,
        "[hull]\ncell_size = \"0.2 cm\"\n[verdict]\nunstated_uncertainty_mm = \"1in\"\n",
    )
    .unwrap();
    let config = Config::load(Some(&file), &[]).unwrap();
    assert_eq!(config.hull.cell_size, 0.002);
    assert_eq!(config.verdict, inch.verdict);
    std::fs::write(&file, "[hull]\ncell_size = \"2mm\"\nresolution = \"2km\"\n").unwrap();
    let message = Config::load(Some(&file), &[]).unwrap_err().to_string();
    assert!(
        message.contains("line 3") && message.contains("2km"),
        "{message}"
    );
}

#[test]
fn what_is_no_length_takes_no_unit_of_one() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lengths.toml");
    for (section, key, text) in [
        ("service", "patience_s", "5m"),
        ("sync", "window_ms", "2m"),
        ("calibration.limits", "good_px", "1mm"),
        ("calibration.plane", "steepest_degrees", "1in"),
        ("hull", "resolution", "100m"),
        ("silhouette", "smoothness", "3cm"),
        ("verdict.skew_ms", "amber", "20m"),
    ] {
        let set = settings(&[&format!("{section}.{key}={text}")]).unwrap_err();
        let set = set.to_string();
        assert!(
            set.contains(&format!("{section}.{key}={text}: ")),
            "{section}.{key}: {set}"
        );
        std::fs::write(&file, format!("[{section}]\n{key} = \"{text}\"\n")).unwrap();
        let message = Config::load(Some(&file), &[]).unwrap_err().to_string();
        assert!(
            message.contains("line 2") && message.contains(key) && message.contains(text),
            "{section}.{key}: {message}"
        );
    }
    // A verdict's limit counts what its section's name says.
    std::fs::write(&file, "[verdict.disagreement_mm]\namber = \"0.5cm\"\n").unwrap();
    let by_file = Config::load(Some(&file), &[]).unwrap();
    assert_eq!(by_file.verdict.disagreement_mm.amber, 5.0);
    let set = settings(&["verdict.disagreement_mm.amber=0.5cm"]).unwrap();
    assert_eq!(set.verdict, by_file.verdict);
}

#[test]
fn lengths_in_arrays_may_have_their_units() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lengths.toml");
    let text = "[rig.volume]\nmin = [\"-150mm\", -0.15, '0 mm']\nmax = [\n  \"15cm\",\n  \"0.15m\",\n  0.4,\n]\n\
                [calibration.wanted]\ndepths = [\"700mm\", 1.3]\n";
    std::fs::write(&file, text).unwrap();
    let config = Config::load(Some(&file), &[]).unwrap();
    let volume = config.rig.volume.as_ref().unwrap();
    assert_eq!(volume.min, [-0.15, -0.15, 0.0]);
    assert_eq!(volume.max, [0.15, 0.15, 0.4]);
    assert_eq!(config.calibration.wanted.depths, [0.7, 1.3]);
    let set = settings(&[
        "rig.volume={min=[\"-150mm\", \"-15cm\", 0.0], max=[0.15, \"150mm\", \"40cm\"]}",
        "calibration.wanted.depths=[\"70cm\", \"1300mm\"]",
    ])
    .unwrap();
    assert_eq!(set.rig.volume, config.rig.volume);
    assert_eq!(set.calibration.wanted, config.calibration.wanted);
    // Another text is no number, and its line is named.
    std::fs::write(&file, text.replace("\"0.15m\"", "\"15 miles\"")).unwrap();
    let message = Config::load(Some(&file), &[]).unwrap_err().to_string();
    assert!(
        message.contains("line 5") && message.contains("15 miles"),
        "{message}"
    );
}

#[test]
fn what_is_wrong_is_named() {
    for (text, named) in [
        ("hull.resolutoin=1", "resolutoin"),
        ("hull.resolutoin=1", "did you mean \"resolution\"?"),
        ("resolution=100", "did you mean hull.resolution?"),
        ("method=hybird", "did you mean \"hybrid\"?"),
        ("nonsense", "section.key=value"),
        ("hull.resolution=many", "many"),
        ("method.x=1", "method"),
        ("=1", "empty"),
        ("hull.resolution=nan", "NaN, expected 8 to 1000"),
        ("verdict.handles.amber=nan", "verdict.handles.amber is nan"),
        (
            "rig.volume={min=[0.0,-nan,0.0],max=[1.0,1.0,1.0]}",
            "rig.volume.min is nan",
        ),
        ("sync.window_ms=-1.0", "0 to 3600000 milliseconds"),
        ("capture.largest_skew_ms=inf", "0 to 3600000 milliseconds"),
        ("service.patience_s=1e9", "0 to 86400 seconds"),
        ("capture.patience_ms=30001", "30001, expected 0 to 30000"),
        ("capture.patience_ms=-1", "-1, expected 0 to 30000"),
        ("capture.retry=11", "11, expected 0 to 10"),
        ("capture.waiting=0", "0, expected 1 to 1000"),
        ("capture.waiting=1001", "1001, expected 1 to 1000"),
        ("capture.memory_mb=0", "0, expected 1 to 1000000"),
        ("capture.memory_mb=1000001", "expected 1 to 1000000"),
        ("recording.largest_file_mb=0", "0, expected 1 to 1000000"),
        ("recording.keep_free_mb=9e18", "9e18"),
        (
            "recording.keep_free_mb=9000000000000000000",
            "expected 0 to 1000000000",
        ),
        ("recording.pack_after_idle_s=86401", "expected 0 to 86400"),
        ("silhouette.significance=-4", "-4, expected 0.001 to 1000"),
        ("silhouette.cell_px=17", "17, expected 0 to 16"),
        ("hull.resolution=0", "0, expected 8 to 1000"),
        ("hull.resolution=100000", "100000, expected 8 to 1000"),
        ("hull.smallest_piece=2", "2, expected 0 to 1"),
        ("hull.least_views=0", "0, expected 1 to 1000"),
        ("depth.levels=0", "0, expected 1 to 12"),
        ("depth.half_width_px=65", "65, expected 0 to 64"),
        ("depth.range_sigma=0", "0, expected 0.001 to 1000"),
        ("region.front_threshold=-1.5", "-1.5, expected -1 to 1"),
        (
            "region.morphology_iterations=10000",
            "10000, expected 0 to 100",
        ),
        (
            "restoration.anchor_weight=inf",
            "inf, expected 0 to 1000000",
        ),
        ("texture.feather_rings=100000000", "expected 0 to 1000"),
        ("glb.jpeg_quality=0", "0, expected 1 to 100"),
        ("glb.jpeg_quality=101", "101, expected 1 to 100"),
        ("sync.depth_frames=1001", "1001, expected 0 to 1000"),
    ] {
        let message = settings(&[text]).unwrap_err().to_string();
        assert!(
            message.contains(named) && message.contains(text),
            "{message}"
        );
    }
}

#[test]
fn the_ends_of_a_range_are_in_it() {
    let least = settings(&[
        "capture.retry=0",
        "capture.patience_ms=0",
        "capture.waiting=1",
        "capture.memory_mb=1",
        "recording.keep_free_mb=0",
    ]);
    assert_eq!(least.unwrap().capture.waiting, 1);
    let most = settings(&[
        "capture.retry=10",
        "capture.patience_ms=30000",
        "capture.waiting=1000",
        "capture.memory_mb=1000000",
        "recording.keep_free_mb=1000000000",
    ]);
    assert_eq!(most.unwrap().capture.patience_ms, 30_000);
}

#[test]
fn a_file_is_refused_with_its_line_and_field() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scand.toml");
    std::fs::write(&path, "[hull]\nresolution = 200.0\nresolutoin = 2\n").unwrap();
    let message = Config::load(Some(&path), &[]).unwrap_err().to_string();
    assert!(
        message.contains("line 3") && message.contains("resolutoin"),
        "{message}"
    );
    assert!(message.contains("scand.toml"), "{message}");
    assert!(
        message.contains("did you mean \"resolution\"?"),
        "{message}"
    );
    std::fs::write(
        &path,
        "[rig]\nname = \"nan\"\n[verdict.handles]\namber = +nan\n",
    )
    .unwrap();
    let message = Config::load(Some(&path), &[]).unwrap_err().to_string();
    assert!(
        message.contains("line 4: verdict.handles.amber is nan"),
        "{message}"
    );
    let missing = Config::load(Some(&folder.path().join("none.toml")), &[]).unwrap_err();
    assert!(missing.to_string().contains("none.toml"));
}

#[test]
fn every_configuration_that_is_shipped_is_read() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    let files: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|f| f.unwrap().path())
        .filter(|file| file.extension().is_some_and(|ending| ending == "toml"))
        // The page's is a file of its own, see `page::Parameters`.
        .filter(|file| !file.ends_with("page.toml"))
        .collect();
    assert!(!files.is_empty());
    for file in files {
        Config::load(Some(&file), &[]).unwrap();
    }
}

#[test]
fn what_a_replay_takes_does_not_depend_on_the_rig_and_is_the_same_from_its_text() {
    let all = settings(&["hull.resolution=160", "method=hull", "glb.jpeg_quality=71"]);
    let rig = settings(&[
        "hull.resolution=160",
        "method=hull",
        "glb.jpeg_quality=71",
        "workers.count=3",
        "socket.path=/x",
    ]);
    let (all, rig) = (all.unwrap(), rig.unwrap());
    assert_ne!(all, rig);
    assert_eq!(all, rig.of_replay());
    let text = toml::to_string(&rig.of_replay()).unwrap();
    assert_eq!(toml::from_str::<Config>(&text).unwrap(), all);
}

#[test]
fn the_shipped_file_shows_every_default() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/replay.toml");
    let shown: Table = toml::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    // By way of its text, in which 0.3 is 0.3 whatever its width.
    let mut defaults: Table =
        toml::from_str(&toml::to_string(&Config::default()).unwrap()).unwrap();
    // What a replay has no use for; calibrate.toml and rig.toml show it.
    for live in [
        "calibration",
        "rig",
        "capture",
        "recording",
        "socket",
        "service",
        "hooks",
        "workers",
        "links",
        "aravis",
        "v4l2",
        "openni2",
    ] {
        assert!(defaults.remove(live).is_some(), "{live}");
    }
    assert_eq!(shown, defaults);
}
#[test]
fn the_file_for_calibrations_shows_every_default_of_theirs() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/calibrate.toml");
    let shown: Table = toml::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let defaults: Table = toml::from_str(&toml::to_string(&Config::default()).unwrap()).unwrap();
    assert_eq!(shown.len(), 1);
    assert_eq!(shown["calibration"], defaults["calibration"]);
}

#[test]
fn what_a_calibration_cannot_be_held_against_is_refused() {
    assert_eq!(Config::default().calibration.checked(), Ok(()));
    for (text, named) in [
        ("calibration.limits.good_px=-1", "-1, expected 0 to 100"),
        ("calibration.limits.coverage=20", "20, expected 0 to 1"),
        ("calibration.limits.views=1001", "1001, expected 0 to 1000"),
        ("calibration.fit.outlier_ratio=0.0", "expected 1 to 1000"),
        ("calibration.fit.min_corners=3", "3, expected 4 to 10000"),
        (
            "calibration.wanted.depths=[0.7, 21.0]",
            "expected two numbers from 0 to 20",
        ),
        ("calibration.wanted.depth_step=0.0", "expected 0.01 to 20"),
        (
            "calibration.watch.moved_px=inf",
            "inf, expected 0.001 to 1000",
        ),
        (
            "calibration.plane.noise_at_1m=0.0",
            "expected 0.000001 to 1",
        ),
    ] {
        let message = settings(&[text]).unwrap_err().to_string();
        assert!(
            message.contains(named) && message.contains(text),
            "{message}"
        );
    }
    for (text, named) in [
        (
            "calibration.limits.good_px=0.5",
            "limits.accepted_px is 0.4, expected 0.5",
        ),
        (
            "calibration.limits.refused_px=0.3",
            "limits.refused_px is 0.3, expected 0.4",
        ),
        (
            "calibration.wanted.depths=[1.3, 0.7]",
            "wanted.depths is 1.3, expected 0 to 0.7",
        ),
    ] {
        let found = settings(&[text]).unwrap().calibration.checked();
        let words = found.unwrap_err();
        assert!(words.contains(named), "{words}");
    }
    assert!(settings(&["calibration.limits.god_px=0.2"]).is_err());
}

#[test]
fn no_message_quotes_an_address_that_may_hold_a_password() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("rig.toml");
    for address in ["\"nats://me:hidden@host\"", "\"nats://me:hidden@host"] {
        std::fs::write(&file, format!("[workers]\nfleet = {address}\n")).unwrap();
        let message = Config::load(Some(&file), &[]).unwrap_err().to_string();
        assert!(message.contains("line 2"), "{message}");
        assert!(!message.contains("hidden"), "{message}");
    }
    for key in ["workers.fleet", "workers.flet", "hull.resolution"] {
        for value in ["nats://me:hidden@h", "\"nats://me:hidden@h\"", "hidden@h"] {
            let message = settings(&[&format!("{key}={value}")]).unwrap_err();
            let message = message.to_string();
            assert!(message.contains(&format!("{key}=…")), "{message}");
            assert!(!message.contains("hidden"), "{message}");
        }
    }
}
