//! Files on the server, in pieces that a message can hold: each piece a subject of its own, so that permissions hold
//! for each, and a piece that was lost can be sent again.

use super::connection::FleetClient;
use super::file_sum::{FileSum, RunningSum};
use super::job::PIECE;
use super::store::ServerError;
use crate::storage::with_advice;
use bytes::Bytes;
use futures_util::stream::FuturesOrdered;
use futures_util::{StreamExt, TryStreamExt, stream};
use std::io::SeekFrom;
use std::path::Path;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncSeekExt, AsyncWriteExt};

/// Pieces of one file under way at a time. A process sends one file at a time, and signs of life wait behind what is
/// under way: two pieces take 8 s over a link of 1 Mbit/s.
const MAX_IN_FLIGHT: usize = 2;
/// How often a piece is asked for while the server is there.
const MAX_TRIES: usize = 3;

/// How long a file waits that the server had no room for.
pub(super) const FULL_PAUSE: Duration = Duration::from_secs(10);

/// Why a file did not arrive.
#[derive(Clone, Debug, thiserror::Error)]
pub(super) enum TransferError {
    /// The server did not serve it.
    #[error(transparent)]
    ServerError(#[from] ServerError),
    /// A piece is not there any more.
    #[error("the server no longer has a piece of the file")]
    Gone,
    /// It is another one.
    #[error("the received file differs from the one that was sent")]
    Differs,
    /// The server never has room for it.
    #[error("it has {bytes} bytes, and the server keeps at most {most} of this kind")]
    TooLarge { bytes: u64, most: u64 },
    /// The disk refuses.
    #[error("{0}")]
    Disk(String),
}

impl TransferError {
    /// Whether the server has no room now, because others' files wait there.
    pub(super) fn is_full(&self) -> bool {
        matches!(self, Self::ServerError(error) if error.is_full())
    }
}

/// How much of a file the server has. It is sent on from there, as long as the connection is the same: a server that
/// was started again may have lost what it had.
#[derive(Debug, Default)]
pub(super) struct Sent {
    pieces: usize,
    connections: u64,
}

fn disk(path: &Path) -> impl Fn(std::io::Error) -> TransferError {
    let path = path.to_owned();
    move |cause| TransferError::Disk(with_advice(&path, &cause))
}

/// How many pieces a file of this length has.
pub(super) fn pieces(bytes: u64) -> usize {
    bytes.div_ceil(PIECE as u64) as usize
}

impl FleetClient {
    /// Stores a file's pieces under the subjects that `subject` names, but for those that were sent. Waits until this
    /// process sends no other file.
    pub(super) async fn send_file(
        &self,
        path: &Path,
        subject: impl Fn(usize) -> String,
        sent: &mut Sent,
    ) -> Result<(), TransferError> {
        let _turn = self.uploads.acquire().await;
        let connections = self.connections();
        if sent.connections != connections {
            *sent = Sent {
                pieces: 0,
                connections,
            };
        }
        let io = disk(path);
        let mut file = tokio::fs::File::open(path).await.map_err(&io)?;
        let from = SeekFrom::Start(sent.pieces as u64 * PIECE as u64);
        file.seek(from).await.map_err(&io)?;
        let mut under_way = FuturesOrdered::new();
        for number in sent.pieces.. {
            let mut piece = Vec::with_capacity(PIECE);
            let read = (&mut file).take(PIECE as u64).read_to_end(&mut piece).await;
            if read.map_err(&io)? == 0 {
                break;
            }
            under_way.push_back(self.store_piece(subject(number), piece.into()));
            if under_way.len() >= MAX_IN_FLIGHT && under_way.try_next().await?.is_some() {
                sent.pieces += 1;
            }
        }
        while under_way.try_next().await?.is_some() {
            sent.pieces += 1;
        }
        Ok(())
    }

    /// Fetches a file's pieces from `stream` into the file at `path`, and compares it with its `sum`.
    pub(super) async fn fetch_file(
        &self,
        stream: &'static str,
        subject: impl Fn(usize) -> String,
        sum: FileSum,
        path: &Path,
    ) -> Result<(), TransferError> {
        let _turn = self.downloads.acquire().await;
        let io = disk(path);
        let mut file = tokio::fs::File::create(path).await.map_err(&io)?;
        let mut arrived = RunningSum::default();
        let asked = (0..pieces(sum.bytes)).map(|number| {
            let subject = subject(number);
            async move { self.stored_piece(stream, &subject).await }
        });
        let mut arriving = stream::iter(asked).buffered(MAX_IN_FLIGHT);
        while let Some(piece) = arriving.next().await {
            let piece: Bytes = piece?.ok_or(TransferError::Gone)?;
            arrived.add(&piece);
            if arrived.bytes() > sum.bytes {
                return Err(TransferError::Differs);
            }
            file.write_all(&piece).await.map_err(&io)?;
        }
        file.flush().await.map_err(&io)?;
        if arrived.finish() == sum {
            Ok(())
        } else {
            Err(TransferError::Differs)
        }
    }

    /// A piece, asked for again if the answer does not come.
    async fn stored_piece(
        &self,
        stream: &str,
        subject: &str,
    ) -> Result<Option<Bytes>, ServerError> {
        let mut answer = self.stored_patiently(stream, subject).await;
        for _ in 1..MAX_TRIES {
            if answer.is_ok() || !self.is_connected() {
                break;
            }
            answer = self.stored_patiently(stream, subject).await;
        }
        answer
    }

    /// Takes a file's pieces off the server.
    pub(super) async fn erase_file(&self, count: usize, subject: impl Fn(usize) -> String) {
        for number in 0..count {
            self.erase(subject(number)).await;
        }
    }
}
