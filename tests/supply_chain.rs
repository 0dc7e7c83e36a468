//! What scand is built from, held against `deny.toml` without any tool but cargo: licences, sources, wildcards. Advisories
//! want a database from the network: `cargo deny check advisories`.

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Whether a licence expression (SPDX) can be met with those that are allowed.
fn is_met(expression: &str, allowed: &BTreeSet<String>) -> bool {
    let spaced = expression.replace('/', " OR ");
    let spaced = spaced.replace('(', " ( ").replace(')', " ) ");
    let words: Vec<&str> = spaced.split_whitespace().collect();
    let mut rest = &words[..];
    let met = either(&mut rest, allowed);
    assert!(rest.is_empty(), "{expression} cannot be read");
    met
}

fn either(rest: &mut &[&str], allowed: &BTreeSet<String>) -> bool {
    let mut met = both(rest, allowed);
    while rest.first() == Some(&"OR") {
        *rest = &rest[1..];
        met |= both(rest, allowed);
    }
    met
}

fn both(rest: &mut &[&str], allowed: &BTreeSet<String>) -> bool {
    let mut met = one(rest, allowed);
    while rest.first() == Some(&"AND") {
        *rest = &rest[1..];
        met &= one(rest, allowed);
    }
    met
}

fn one(rest: &mut &[&str], allowed: &BTreeSet<String>) -> bool {
    if rest.first() == Some(&"(") {
        *rest = &rest[1..];
        let met = either(rest, allowed);
        assert_eq!(rest.first(), Some(&")"));
        *rest = &rest[1..];
        return met;
    }
    let length = if rest.get(1) == Some(&"WITH") { 3 } else { 1 };
    let (name, behind) = rest.split_at(length);
    *rest = behind;
    allowed.contains(&name.join(" "))
}

#[test]
fn expressions_are_read_as_spdx_means_them() {
    let allowed = ["MIT", "Zlib", "Apache-2.0 WITH LLVM-exception"].map(str::to_owned);
    let allowed = BTreeSet::from(allowed);
    for met in [
        "MIT",
        "GPL-3.0 OR MIT",
        "MIT/Apache-2.0",
        "Zlib AND (MIT OR X)",
    ] {
        assert!(is_met(met, &allowed), "{met}");
    }
    assert!(is_met("Apache-2.0 WITH LLVM-exception OR X", &allowed));
    for unmet in [
        "GPL-3.0",
        "MIT AND GPL-3.0",
        "Apache-2.0",
        "(X OR Y) AND MIT",
    ] {
        assert!(!is_met(unmet, &allowed), "{unmet}");
    }
}

/// What cargo knows of the crates that are built for Linux, with all features.
fn metadata() -> Value {
    let target = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--offline", "--locked", "--format-version", "1"])
        .args(["--features", "rig", "--filter-platform", &target])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn licences_and_sources_are_those_that_may_be_depended_on() {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/deny.toml")).unwrap();
    let deny: toml::Table = toml::from_str(&text).unwrap();
    let allowed = deny["licenses"]["allow"].as_array().unwrap().iter();
    let allowed: BTreeSet<String> = allowed.map(|l| l.as_str().unwrap().to_owned()).collect();
    let metadata = metadata();
    let nodes = metadata["resolve"]["nodes"].as_array().unwrap().iter();
    let used: BTreeSet<&str> = nodes.map(|n| n["id"].as_str().unwrap()).collect();
    let packages = metadata["packages"].as_array().unwrap().iter();
    let mut versions = BTreeMap::<&str, Vec<&str>>::new();
    for package in packages.filter(|p| used.contains(p["id"].as_str().unwrap())) {
        let name = package["name"].as_str().unwrap();
        if name == "scand" {
            for dependency in package["dependencies"].as_array().unwrap() {
                assert_ne!(dependency["req"], "*", "{dependency}");
            }
            continue;
        }
        let licence = package["license"].as_str().unwrap_or("none");
        assert!(is_met(licence, &allowed), "{name}: {licence}");
        let source = package["source"].as_str().unwrap_or("none");
        assert_eq!(
            source, "registry+https://github.com/rust-lang/crates.io-index",
            "{name}"
        );
        versions
            .entry(name)
            .or_default()
            .push(package["version"].as_str().unwrap());
    }
    assert!(versions.len() > 100, "{} crates", versions.len());
    let count: usize = versions.values().map(Vec::len).sum();
    let twice: Vec<_> = versions.iter().filter(|(_, v)| v.len() > 1).collect();
    println!(
        "shown: {count} crates of crates.io with licences that are allowed; in more than one version: {twice:?}"
    );
}
