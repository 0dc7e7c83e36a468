//! Runs `scand --replay` on a hostile file with little memory, and checks what must hold whatever the file.

use super::recording::Messages;
use assert_cmd::Command;
use assert_cmd::cargo::cargo_bin;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tempfile::TempDir;

/// What a run left.
pub struct Ended {
    folder: TempDir,
    pub code: i32,
    pub stderr: String,
}

/// Models as coarse as will do, because nothing is asked of them but that they are there.
const COARSE: [&str; 2] = ["--set", "hull.resolution=40"];

/// KiB of address space for a file that is refused: 256 MiB, and what the program itself takes.
const REFUSED_KIB: u64 = (256 + 64) << 10;

/// Replays a file of these bytes.
pub fn replay_bytes(name: &str, bytes: &[u8]) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(format!("{name}.mcap"));
    std::fs::write(&file, bytes).unwrap();
    replay(folder, &file, Some(REFUSED_KIB), &COARSE)
}

/// Replays a recording that should be refused before anything is reconstructed.
pub fn replay_refused(name: &str, messages: &Messages) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(format!("{name}.mcap"));
    messages.write(&file, Some(mcap::Compression::Zstd));
    replay(folder, &file, Some(REFUSED_KIB), &[])
}

/// Replays a recording of which something can be reconstructed.
pub fn replay_whole(name: &str, messages: &Messages) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(format!("{name}.mcap"));
    messages.write(&file, Some(mcap::Compression::Zstd));
    replay(folder, &file, None, &COARSE)
}

/// Replays a file into the folder beside it.
pub fn replay(folder: TempDir, file: &Path, limit_kib: Option<u64>, settings: &[&str]) -> Ended {
    if let Some(kept) = std::env::var_os("SCAND_KEEP_HOSTILE").filter(|_| file.is_file()) {
        let kept = PathBuf::from(kept).join(file.file_name().unwrap());
        std::fs::copy(file, kept).unwrap();
    }
    // A shell's limit on the address space needs no code of ours; the two settings keep threads and their
    // allocators from reserving more of it on large machines.
    let limit = limit_kib.map_or("unlimited".to_owned(), |kib| kib.to_string());
    let output = Command::new("sh")
        .args(["-c", "ulimit -v $0; exec \"$@\"", &limit])
        .arg(cargo_bin("scand"))
        .arg("--replay")
        .arg(file)
        .args(settings)
        .arg("--out")
        .arg(folder.path().join("out"))
        .env("RAYON_NUM_THREADS", "2")
        .env("MALLOC_ARENA_MAX", "1")
        .timeout(Duration::from_secs(60))
        .output()
        .unwrap();
    let ended = Ended {
        folder,
        code: output.status.code().unwrap_or(-1),
        stderr: String::from_utf8(output.stderr).unwrap(),
    };
    ended.check(file);
    ended
}

impl Ended {
    /// What holds for every file.
    fn check(&self, file: &Path) {
        let (code, stderr) = (self.code, &self.stderr);
        let name = file.file_name().unwrap().to_str().unwrap();
        assert!(
            [0, 1, 3].contains(&code),
            "{name}: exit code {code}: {stderr}"
        );
        for word in [
            "panicked",
            "internal error",
            "scand has a bug",
            "overflow",
            "memory allocation",
        ] {
            assert!(!stderr.contains(word), "{name}: {stderr}");
        }
        assert!(code == 0 || stderr.contains(name), "{name}: {stderr}");
        for capture in self.captures() {
            let has = |file: &str| capture.join(file).is_file();
            let is_whole = ["model.glb", "model.ply", "preview.png"].map(has);
            let report = std::fs::read(capture.join("report.json")).unwrap();
            let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
            let failed = report["outcome"] == "failed";
            assert_eq!(is_whole, [!failed; 3], "{name}: {}", capture.display());
        }
    }

    /// The folders of the captures. Nothing else may be where they are.
    pub fn captures(&self) -> Vec<PathBuf> {
        let entries = |folder: &Path| -> Vec<PathBuf> {
            let read = std::fs::read_dir(folder).into_iter().flatten();
            read.map(|entry| entry.unwrap().path()).collect()
        };
        let recordings = entries(&self.folder.path().join("out"));
        let captures: Vec<PathBuf> = recordings.iter().flat_map(|r| entries(r)).collect();
        for path in recordings.iter().chain(&captures) {
            let name = path.file_name().unwrap().to_str().unwrap();
            assert!(path.is_dir() && !name.starts_with('.'), "{name} was left");
        }
        captures
    }

    /// The report of a capture.
    pub fn report(&self, capture: &str) -> serde_json::Value {
        let captures = self.captures();
        let folder = captures.iter().find(|path| path.ends_with(capture));
        let report = std::fs::read(folder.unwrap().join("report.json")).unwrap();
        serde_json::from_slice(&report).unwrap()
    }

    /// Nothing was made of the file, for a reason that has these words.
    pub fn is_refused(&self, words: &[&str]) {
        assert_eq!(self.code, 1, "{}", self.stderr);
        self.says(words);
    }

    /// The words are told.
    pub fn says(&self, words: &[&str]) {
        for word in words {
            assert!(self.stderr.contains(word), "{word:?}: {}", self.stderr);
        }
    }
}
