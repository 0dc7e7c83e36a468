//! Writes files under a temporary name, makes them durable and then renames them, so that a file under its final
//! name is complete, whenever the power fails.

use super::Error;
use std::fs::{self, File, OpenOptions};
use std::io::ErrorKind::{AlreadyExists, InvalidInput, PermissionDenied, Unsupported};
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Distinguishes the temporary names of one process.
static NEXT: AtomicU32 = AtomicU32::new(0);

/// A file's bytes, if it has at most `most`; a file that grows meanwhile, or that has no size, is bounded as well.
///
/// # Errors
/// If it cannot be read, or is larger.
pub fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut bytes = Vec::new();
    if length <= most {
        file.take(most + 1).read_to_end(&mut bytes)?;
    }
    let length = length.max(bytes.len() as u64);
    if length > most {
        let message = format!("{length} bytes, expected at most {most}");
        return Err(io::Error::other(message));
    }
    Ok(bytes)
}

/// As [`read`], a file of text.
///
/// # Errors
/// As those of [`read`], and if it is not UTF-8.
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    let text = String::from_utf8(read(path, most)?);
    text.map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "it is not UTF-8"))
}

/// Writes a file so that under its final name there is the old content or all of the new, never a part.
///
/// # Errors
/// If the file system refuses a step; the error names the path, and nothing is left behind.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    put(path, bytes, &mut File::options())
}

/// As [`write_atomically`], a file that replaces none.
///
/// # Errors
/// [`Error::Exists`] if something has the name; else as those of [`write_atomically`].
pub fn write_new(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    put_new(path, bytes, &mut File::options())
}

/// As [`write_new`], a file that its owner alone may read.
///
/// # Errors
/// As those of [`write_new`].
pub fn write_new_for_owner(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    put_new(path, bytes, File::options().mode(0o600))
}

fn put_new(path: &Path, bytes: &[u8], options: &mut OpenOptions) -> Result<(), Error> {
    place(path, bytes, options, |part| {
        rename_noreplace(part, path).map_err(|cause| match cause.kind() {
            AlreadyExists => Error::Exists {
                path: path.to_owned(),
            },
            _ => Error::io("rename into place", path)(cause),
        })
    })
}

/// As [`write_atomically`], a file that its owner alone may read.
///
/// # Errors
/// As those of [`write_atomically`].
pub fn write_atomically_for_owner(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    put(path, bytes, File::options().mode(0o600))
}

fn put(path: &Path, bytes: &[u8], options: &mut OpenOptions) -> Result<(), Error> {
    place(path, bytes, options, |part| {
        fs::rename(part, path).map_err(Error::io("rename into place", path))
    })
}

/// Writes a file beside `path`, and lets `rename` give it its name.
fn place(
    path: &Path,
    bytes: &[u8],
    options: &mut OpenOptions,
    rename: impl FnOnce(&Path) -> Result<(), Error>,
) -> Result<(), Error> {
    let (parent, name) = split(path)?;
    fs::create_dir_all(&parent).map_err(Error::io("create", &parent))?;
    let part = parent.join(temporary_name(&name, "part"));
    let written = write_durably(&part, bytes, options)
        .and_then(|_locked| rename(&part))
        .and_then(|()| sync_folder(&parent).map_err(Error::io("write", &parent)));
    if written.is_err() {
        // The error that matters is the first one.
        let _ = fs::remove_file(&part);
    }
    written
}

/// Makes a folder and puts a file into it that is removed at once: so it is known before long work whether its results
/// can be written.
///
/// # Errors
/// If the folder cannot be made or written to.
pub fn check_writable(folder: &Path) -> Result<(), Error> {
    fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
    let probe = folder.join(temporary_name("scand", "probe"));
    File::create_new(&probe).map_err(Error::io("write to", folder))?;
    fs::remove_file(&probe).map_err(Error::io("remove", &probe))
}

/// Gives a file its name, which no other file may have: unlike a rename, a link replaces nothing.
///
/// # Errors
/// `AlreadyExists` if another file has the name; else what the file system says. The file then keeps its old name.
pub fn rename_noreplace(from: &Path, to: &Path) -> io::Result<()> {
    match fs::hard_link(from, to) {
        Ok(()) => fs::remove_file(from),
        // A file system without links.
        Err(cause) if matches!(cause.kind(), Unsupported | PermissionDenied) => {
            if to.try_exists()? {
                return Err(AlreadyExists.into());
            }
            fs::rename(from, to)
        }
        Err(cause) => Err(cause),
    }
}

/// Gives a file another name, which replaces what has that, and makes the names durable.
///
/// # Errors
/// What the file system says.
pub fn rename_durably(from: &Path, to: &Path) -> io::Result<()> {
    fs::rename(from, to)?;
    sync_parent(to)
}

/// Makes the names in a folder durable.
///
/// # Errors
/// If the folder cannot be opened or brought to the disk.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

/// Makes a file's name durable, and those of its neighbours.
///
/// # Errors
/// If its folder cannot be opened or brought to the disk.
pub fn sync_parent(path: &Path) -> io::Result<()> {
    sync_folder(&parent(path))
}

/// Writes a file that is locked until what is returned is dropped, so that others know that its writer lives.
pub(super) fn write_durably(
    path: &Path,
    bytes: &[u8],
    options: &mut OpenOptions,
) -> Result<File, Error> {
    let file = options.write(true).create(true).truncate(true).open(path);
    let mut file = file.map_err(Error::io("create", path))?;
    // The system releases it when this process dies. A file system without locks keeps what is left.
    let _ = file.try_lock();
    file.write_all(bytes).map_err(Error::io("write", path))?;
    file.sync_data().map_err(Error::io("write", path))?;
    Ok(file)
}

/// Hidden, beside the target, of this process and this call.
pub(super) fn temporary_name(name: &str, kind: &str) -> String {
    let number = NEXT.fetch_add(1, Ordering::Relaxed);
    let prefix = temporary_prefix(name, kind);
    format!("{prefix}{}-{number}", std::process::id())
}

pub(super) fn temporary_prefix(name: &str, kind: &str) -> String {
    format!(".{name}.{kind}-")
}

/// A path's folder and its last name.
pub(super) fn split(path: &Path) -> Result<(PathBuf, String), Error> {
    let name = path.file_name().ok_or_else(|| {
        let no_name = io::Error::new(InvalidInput, "it has no name");
        Error::io("write", path)(no_name)
    })?;
    Ok((parent(path), name.to_string_lossy().into_owned()))
}

fn parent(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent.to_owned(),
        _ => PathBuf::from("."),
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::names;
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_file_is_replaced_whole_and_nothing_stays_beside_it() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("deep/er/a.txt");
        write_atomically(&path, b"one").unwrap();
        write_atomically(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(names(path.parent().unwrap()), ["a.txt"]);
    }

    #[test]
    fn a_new_file_replaces_none() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("a.txt");
        write_new(&path, b"one").unwrap();
        let error = write_new(&path, b"two").unwrap_err();
        assert!(matches!(error, Error::Exists { .. }), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"one");
        assert_eq!(names(home.path()), ["a.txt"]);
    }

    #[test]
    fn an_error_names_the_path_and_leaves_nothing() {
        let home = tempfile::tempdir().unwrap();
        let taken = home.path().join("folder");
        fs::create_dir(&taken).unwrap();
        let error = write_atomically(&taken, b"x").unwrap_err().to_string();
        assert!(error.contains(taken.to_str().unwrap()), "{error}");
        assert_eq!(names(home.path()), ["folder"]);
    }

    #[test]
    fn what_is_for_the_owner_nobody_else_may_read() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("a.txt");
        let new = home.path().join("b.txt");
        write_atomically_for_owner(&path, b"one").unwrap();
        write_new_for_owner(&new, b"one").unwrap();
        for path in [path, new] {
            let mode = fs::metadata(&path).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
        }
    }

    #[test]
    fn a_name_that_is_taken_stays_with_its_file() {
        let home = tempfile::tempdir().unwrap();
        let [new, taken] = ["new", "taken"].map(|name| home.path().join(name));
        fs::write(&new, b"new").unwrap();
        fs::write(&taken, b"old").unwrap();
        let error = rename_noreplace(&new, &taken).unwrap_err();
        assert_eq!(error.kind(), AlreadyExists);
        assert_eq!(fs::read(&taken).unwrap(), b"old");
        fs::remove_file(&taken).unwrap();
        rename_noreplace(&new, &taken).unwrap();
        assert_eq!(names(home.path()), ["taken"]);
    }
}
