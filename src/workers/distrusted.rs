//! Models that a worker of the fleet made which made another one wrong. The process of the fleet marks them; whoever
//! makes one of them again, here or there, replaces it, although nobody said that models may be replaced.

use std::path::{Path, PathBuf};

/// The file that says in a model's folder that its worker made another model wrong.
pub const MARK: &str = "distrusted.txt";

/// Whether a model's worker made another model wrong.
pub fn is_marked(target: &Path) -> bool {
    target.join(MARK).exists()
}

/// The file beside a model's folder that says which worker made it.
pub fn origin_path(target: &Path) -> PathBuf {
    let name = target.file_name().unwrap_or_default().to_string_lossy();
    target.with_file_name(format!(".{name}.fleet"))
}

/// Whether a model that is to be made here has to replace one that is marked. Then it is not said any more which worker
/// made it, for that is not true of the one that comes; the mark stays as long as the marked one.
pub fn is_to_be_replaced(target: &Path) -> bool {
    let is_marked = is_marked(target);
    if is_marked {
        let _ = std::fs::remove_file(origin_path(target));
    }
    is_marked
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_marked_model_that_is_to_be_replaced_is_no_workers_any_more_and_others_are_left_alone() {
        let home = tempfile::tempdir().unwrap();
        let target = |name: &str| home.path().join(name);
        for name in ["a1", "a2"] {
            std::fs::create_dir(target(name)).unwrap();
            std::fs::write(origin_path(&target(name)), "{}").unwrap();
        }
        std::fs::write(target("a1").join(MARK), "").unwrap();
        let replaced = ["a1", "a2"].map(|name| is_to_be_replaced(&target(name)));
        assert_eq!(replaced, [true, false]);
        let known = ["a1", "a2"].map(|name| origin_path(&target(name)).exists());
        assert_eq!(known, [false, true]);
        assert!(is_marked(&target("a1")));
    }
}
