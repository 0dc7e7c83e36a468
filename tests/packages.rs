//! Checks which of our packages are built into which program, as cargo resolves them.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// The packages that cargo's tree has with these options.
fn tree(options: &[&str]) -> BTreeSet<String> {
    let output = Command::new(env!("CARGO"))
        .args(["tree", "--offline", "--locked", "--package", "scand"])
        .args(["--prefix", "none", "--format", "{lib}"])
        .args(options)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let names = String::from_utf8(output.stdout).unwrap();
    // What was listed already comes with a mark behind its name.
    let names = names.lines().filter_map(|line| line.split(' ').next());
    names.map(str::to_owned).collect()
}

/// All packages in the program `scand` that is built with these options.
fn all_packages(options: &[&str]) -> BTreeSet<String> {
    tree(&[&["--edges", "normal"], options].concat())
}

/// Our packages in it.
fn packages(options: &[&str]) -> BTreeSet<String> {
    let mut packages = all_packages(options);
    packages.retain(|name| name.starts_with("scand"));
    packages
}

#[test]
fn only_the_feature_fleet_brings_its_client() {
    let has = |names: [&str; 2], options: &[&str]| {
        let packages = all_packages(options);
        names.map(|name| packages.contains(name))
    };
    let (client, ciphers) = (["async_nats", "nkeys"], ["rustls", "ring"]);
    assert_eq!(has(client, &["--features", "rig,page"]), [false; 2]);
    assert_eq!(has(client, &["--features", "fleet"]), [true; 2]);
    // The page has TLS of its own.
    assert_eq!(has(ciphers, &[]), [false; 2]);
    assert_eq!(has(ciphers, &["--features", "rig"]), [false; 2]);
}

/// What needs a C++ compiler, CMake or libclang stays behind a feature.
#[test]
fn the_default_build_needs_rust_and_a_c_compiler_alone() {
    let edges = ["--edges", "normal,build"];
    let all = tree(&edges);
    // The list is that of the build: its build scripts are there.
    assert!(all.contains("cc") && all.contains("scand_core"), "{all:?}");
    for tool in [
        "cmake",
        "bindgen",
        "clang_sys",
        "cxx",
        "cxx_build",
        "autocxx",
        "cpp",
        "cpp_build",
        "link_cplusplus",
        "meson",
        "nasm_rs",
    ] {
        assert!(!all.contains(tool), "the default build has {tool}");
    }
    // Those that compile something that is not Rust: C, or assembly. A new one must be looked at before it is listed
    // here.
    let compiled = tree(&[&edges[..], &["--invert", "cc", "--depth", "1"]].concat());
    let known = ["cc", "generator", "lz4_sys", "zstd_sys"].map(str::to_owned);
    assert_eq!(compiled, known.into());
}

#[test]
fn an_installed_rig_holds_no_simulator() {
    let script = include_str!("../scripts/deb.sh");
    let options = ["--no-default-features", "--features", "rig,page,fleet"];
    let built = format!("features=({})\n", options.join(" "));
    assert!(script.contains(&built), "how the package is built");
    assert_eq!(
        packages(&options),
        ["scand", "scand_core"].map(str::to_owned).into()
    );
    // What is built otherwise has it.
    let all = ["scand", "scand_core", "scand_lab"].map(str::to_owned);
    assert_eq!(packages(&["--features", "rig,page,fleet"]), all.into());
}

#[test]
fn an_installed_worker_holds_no_camera_no_page_and_no_simulator() {
    let script = include_str!("../scripts/deb.sh");
    let options = ["--no-default-features", "--features", "fleet"];
    let built = format!("features=({})\n", options.join(" "));
    assert!(script.contains(&built), "how the package is built");
    let expected = ["scand", "scand_core"].map(str::to_owned);
    assert_eq!(packages(&options), expected.into());
    let of_rigs = ["aravis", "gio", "v4l", "evdev", "axum", "hyper"];
    let has = |options: &[&str]| {
        let packages = all_packages(options);
        of_rigs.map(|name| packages.contains(name))
    };
    assert_eq!(has(&options), [false; 6]);
    assert_eq!(has(&["--features", "rig,page,fleet"]), [true; 6]);
}

/// The files of the packages `scand` and `scand-worker`: where each is installed, and what it is made of.
fn package_files() -> [BTreeMap<String, String>; 2] {
    let manifest: toml::Table = include_str!("../Cargo.toml").parse().unwrap();
    let rig = &manifest["package"]["metadata"]["deb"];
    let worker = &rig["variants"]["worker"];
    assert_eq!(worker["name"].as_str(), Some("scand-worker"));
    [rig, worker].map(|of| {
        let assets = of["assets"].as_array().unwrap().iter();
        let file = |asset: &toml::Value| {
            let [from, to] = [0, 1].map(|i| asset[i].as_str().unwrap());
            let is_folder = to.ends_with('/');
            let name = from.rsplit('/').next().unwrap();
            let installed = format!("{to}{}", if is_folder { name } else { "" });
            (installed, from.to_owned())
        };
        assets.map(file).collect()
    })
}

#[test]
fn the_packages_have_man_pages_and_completions() {
    let script = include_str!("../scripts/deb.sh");
    let [rig, worker] = package_files();
    let share = "usr/share";
    for (files, installed, made_by) in [
        (&rig, "man/man1/*.1", "generate man $generated/man"),
        (
            &rig,
            "bash-completion/completions/scand",
            "generate completions bash >$generated/bash/scand",
        ),
        (
            &rig,
            "zsh/vendor-completions/_scand",
            "generate completions zsh >$generated/zsh/_scand",
        ),
        (
            &rig,
            "fish/vendor_completions.d/scand.fish",
            "generate completions fish >$generated/fish/scand.fish",
        ),
        (
            &worker,
            "man/man1/scand-worker.1",
            "mv $generated/man/scand-worker.1 $generated/worker/",
        ),
    ] {
        let from = files.get(&format!("{share}/{installed}"));
        let from = from.unwrap_or_else(|| panic!("{installed} is in no package: {files:?}"));
        assert!(script.contains(made_by), "{made_by}");
        // The package takes the file from where the script puts it.
        let folder = from.rsplit_once('/').unwrap().0;
        let put = made_by.rsplit(['>', ' ']).next().unwrap();
        let put = put.replace("$generated", "target/generated");
        assert!(put.starts_with(folder), "{from} is not made: {made_by}");
    }
}

/// Both packages can be installed at once, so no file may be in both.
#[test]
fn the_packages_share_no_file() {
    let files = package_files().map(|files| files.into_keys().collect::<BTreeSet<_>>());
    let [rig, worker] = files;
    assert!(worker.contains("usr/bin/scand-worker") && rig.contains("usr/bin/scand"));
    assert_eq!(rig.intersection(&worker).count(), 0, "{rig:?} {worker:?}");
}

/// The features that these bring, with those that they bring.
fn all_features(features: &toml::Table, of: &str) -> BTreeSet<String> {
    let mut all = BTreeSet::new();
    let mut left = vec![of.to_owned()];
    while let Some(feature) = left.pop() {
        let brought = features.get(&feature).into_iter();
        let brought = brought.flat_map(|brought| brought.as_array().unwrap());
        left.extend(brought.map(|feature| feature.as_str().unwrap().to_owned()));
        all.insert(feature);
    }
    all
}

/// Cargo passes over a program of tests in silence when a feature is missing that it requires.
#[test]
fn the_gate_has_the_features_that_each_program_of_tests_requires() {
    let makefile = include_str!("../Makefile");
    let given = makefile
        .lines()
        .find_map(|line| line.strip_prefix("FEATURES = "));
    assert!(
        makefile
            .lines()
            .any(|line| line.ends_with("test --locked --workspace --features $(FEATURES)"))
    );
    let manifest: toml::Table = include_str!("../Cargo.toml").parse().unwrap();
    let features = manifest["features"].as_table().unwrap();
    let given = given.unwrap().split(',').chain(["default"]);
    let given: BTreeSet<String> = given.flat_map(|one| all_features(features, one)).collect();
    let mut required = BTreeSet::new();
    for test in manifest["test"].as_array().unwrap() {
        for feature in test["required-features"].as_array().unwrap() {
            let feature = feature.as_str().unwrap();
            assert!(given.contains(feature), "{feature}: {test} {given:?}");
            required.insert(feature);
        }
    }
    assert!(required.contains("aravis"), "{required:?}");
}
