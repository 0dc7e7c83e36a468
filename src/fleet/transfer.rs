//! Files on the server, in pieces that a message can hold: each piece a subject of its own, so that permissions hold
//! for each, and a piece that was lost can be sent again.

use super::connection::FleetClient;
use super::job::{PIECE, hexadecimal};
use super::store::ServerError;
use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use sha2::{Digest, Sha256};
use std::path::Path;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

/// Pieces under way at a time.
const MAX_IN_FLIGHT: usize = 4;

/// Why a file did not arrive.
#[derive(Clone, Debug, thiserror::Error)]
pub(super) enum TransferError {
    /// The server did not serve it.
    #[error(transparent)]
    ServerError(#[from] ServerError),
    /// A piece is not there any more.
    #[error("a piece is not on the server any more")]
    Gone,
    /// It is another one.
    #[error("the received file differs from the one that was sent")]
    Differs,
    /// The disk refuses.
    #[error("{0}")]
    Disk(String),
}

fn disk(path: &Path) -> impl Fn(std::io::Error) -> TransferError {
    let path = path.display().to_string();
    move |cause| TransferError::Disk(format!("{path}: {cause}"))
}

/// How many pieces a file of this length has.
pub(super) fn pieces(bytes: u64) -> usize {
    bytes.div_ceil(PIECE as u64) as usize
}

impl FleetClient {
    /// Stores a file's pieces under the subjects that `subject` names.
    pub(super) async fn send_file(
        &self,
        path: &Path,
        subject: impl Fn(usize) -> String,
    ) -> Result<(), TransferError> {
        let io = disk(path);
        let mut file = tokio::fs::File::open(path).await.map_err(&io)?;
        let mut under_way = stream::FuturesUnordered::new();
        for number in 0.. {
            let mut piece = Vec::with_capacity(PIECE);
            let read = (&mut file).take(PIECE as u64).read_to_end(&mut piece).await;
            if read.map_err(&io)? == 0 {
                break;
            }
            under_way.push(self.store(subject(number), piece.into()));
            if under_way.len() >= MAX_IN_FLIGHT {
                under_way.try_next().await?;
            }
        }
        while under_way.try_next().await?.is_some() {}
        Ok(())
    }

    /// Fetches a file's pieces from `stream` into the file at `path`, and compares it with its length and digest.
    pub(super) async fn fetch_file(
        &self,
        stream: &'static str,
        subject: impl Fn(usize) -> String,
        (bytes, sha256): (u64, &str),
        path: &Path,
    ) -> Result<(), TransferError> {
        let io = disk(path);
        let mut file = tokio::fs::File::create(path).await.map_err(&io)?;
        let mut hash = Sha256::new();
        let mut length = 0;
        let asked = (0..pieces(bytes)).map(|number| {
            let subject = subject(number);
            async move { self.stored(stream, &subject).await }
        });
        let mut arriving = stream::iter(asked).buffered(MAX_IN_FLIGHT);
        while let Some(piece) = arriving.next().await {
            let piece: Bytes = piece?.ok_or(TransferError::Gone)?;
            length += piece.len() as u64;
            if length > bytes {
                return Err(TransferError::Differs);
            }
            hash.update(&piece);
            file.write_all(&piece).await.map_err(&io)?;
        }
        file.flush().await.map_err(&io)?;
        if length == bytes && hexadecimal(&hash.finalize()) == sha256 {
            Ok(())
        } else {
            Err(TransferError::Differs)
        }
    }

    /// Takes a file's pieces off the server.
    pub(super) async fn erase_file(&self, count: usize, subject: impl Fn(usize) -> String) {
        for number in 0..count {
            self.erase(subject(number)).await;
        }
    }
}
