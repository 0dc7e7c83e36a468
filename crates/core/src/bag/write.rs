//! Makes a package: under another name first, so that a folder that has its final name is complete.

use super::Error;
use super::manifest::text;
use crate::storage::{StagedFolder, sync_folder};
use crate::words::hexadecimal;
use sha2::{Digest, Sha512};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// A package in the making.
pub struct Bag {
    staged: StagedFolder,
    target: PathBuf,
    /// Digests of the files under `data/`, by their paths.
    payload: BTreeMap<String, String>,
    bytes: u64,
}

impl Bag {
    /// Begins a package.
    ///
    /// # Errors
    /// If something has its name, or the folder cannot be written.
    pub fn create(target: &Path) -> Result<Self, Error> {
        if target.symlink_metadata().is_ok() {
            return Err(Error::Exists(target.into()));
        }
        let staged = StagedFolder::create(target).map_err(|cause| Error::Io {
            path: target.into(),
            cause: std::io::Error::other(cause),
        })?;
        Ok(Self {
            staged,
            target: target.into(),
            payload: BTreeMap::new(),
            bytes: 0,
        })
    }

    /// Puts a text or picture at `path` below `data/`.
    ///
    /// # Errors
    /// If another file has the path, or it cannot be written.
    pub fn put(&mut self, path: &str, bytes: &[u8]) -> Result<(), Error> {
        self.copy(path, &mut &*bytes, Path::new(path))
    }

    /// Puts a copy of a file at `path` below `data/`.
    ///
    /// # Errors
    /// As for [`Self::put`], or if the file cannot be read.
    pub fn put_file(&mut self, path: &str, file: &Path) -> Result<(), Error> {
        let mut from = File::open(file).map_err(Error::io(file))?;
        self.copy(path, &mut from, file)
    }

    fn copy(&mut self, path: &str, from: &mut impl Read, source: &Path) -> Result<(), Error> {
        let path = format!("data/{path}");
        if self.payload.contains_key(&path) {
            return Err(Error::Twice(path));
        }
        let (digest, bytes) = self.write(&path, from, source)?;
        self.bytes += bytes;
        self.payload.insert(path, digest);
        Ok(())
    }

    /// Writes a file and brings it to the disk; its SHA-512 and its length. `source` is what cannot be read if reading
    /// fails.
    fn write(
        &self,
        path: &str,
        from: &mut impl Read,
        source: &Path,
    ) -> Result<(String, u64), Error> {
        let target = self.staged.path().join(path);
        if let Some(folder) = target.parent() {
            fs::create_dir_all(folder).map_err(Error::io(folder))?;
        }
        let mut file = File::create_new(&target).map_err(Error::io(&target))?;
        let (mut hash, mut bytes) = (Sha512::new(), 0);
        let mut buffer = vec![0; 1 << 18];
        loop {
            let read = from.read(&mut buffer).map_err(Error::io(source))?;
            if read == 0 {
                break;
            }
            hash.update(&buffer[..read]);
            bytes += read as u64;
            file.write_all(&buffer[..read])
                .map_err(Error::io(&target))?;
        }
        file.sync_data().map_err(Error::io(&target))?;
        Ok((hexadecimal(&hash.finalize()), bytes))
    }

    /// Completes the package, with pairs for `bag-info.txt`. Line breaks in them become spaces.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(self, about: &[(&str, String)]) -> Result<(), Error> {
        let files = self.payload.len();
        let oxum = ("Payload-Oxum", format!("{}.{files}", self.bytes));
        let one_line = |text: &str| text.replace(['\n', '\r'], " ");
        let pairs = about.iter().chain(std::iter::once(&oxum));
        let info: String = pairs
            .map(|(name, text)| format!("{name}: {}\n", one_line(text)))
            .collect();
        let declaration = "BagIt-Version: 1.0\nTag-File-Character-Encoding: UTF-8\n";
        let mut tags = BTreeMap::new();
        for (name, contents) in [
            ("bagit.txt", declaration.to_owned()),
            ("bag-info.txt", info),
            ("manifest-sha512.txt", text(&self.payload)),
        ] {
            let (digest, _) = self.write(name, &mut contents.as_bytes(), Path::new(name))?;
            tags.insert(name.to_owned(), digest);
        }
        let name = "tagmanifest-sha512.txt";
        self.write(name, &mut text(&tags).as_bytes(), Path::new(name))?;
        let root = self.staged.path();
        let folders = self
            .payload
            .keys()
            .flat_map(|path| Path::new(path).ancestors().skip(1));
        let mut folders: Vec<PathBuf> = folders.map(|folder| root.join(folder)).collect();
        folders.sort();
        folders.dedup();
        for folder in folders.iter().rev() {
            sync_folder(folder).map_err(Error::io(folder))?;
        }
        let target = self.target;
        self.staged.commit(false).map_err(|cause| Error::Io {
            path: target,
            cause: std::io::Error::other(cause),
        })
    }
}
