//! A connection whose other end must take what it is sent.

use super::places::Connection;
use std::io::{Error, ErrorKind, IoSlice, Result};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Sleep, sleep};

/// Whoever takes less than this, in bytes, within its time gains no more of it: a client that takes a byte
/// now and then would hold what it was sent for hours.
const PROGRESS: usize = 4096;

/// A stream that fails where nobody takes what is written to it.
#[derive(Debug)]
pub struct Patience {
    stream: TcpStream,
    place: Arc<Connection>,
    limit: Duration,
    blocked: Option<Blocked>,
}

/// Something waits to be taken.
#[derive(Debug)]
struct Blocked {
    end: Pin<Box<Sleep>>,
    taken: usize,
}

impl Patience {
    /// A stream whose other end may block it for so long.
    pub fn new(stream: TcpStream, place: Arc<Connection>, limit: Duration) -> Self {
        Self { stream, place, limit, blocked: None }
    }

    /// Counts what was taken, or the time in which nothing was.
    fn judge(&mut self, context: &mut Context<'_>, written: Poll<Result<usize>>) -> Poll<Result<usize>> {
        if let Poll::Ready(outcome) = written {
            if let Ok(length) = outcome {
                self.place.heard();
                if let Some(blocked) = &mut self.blocked {
                    blocked.taken += length;
                    if blocked.taken >= PROGRESS {
                        self.blocked = None;
                    }
                }
            }
            return Poll::Ready(outcome);
        }
        let limit = self.limit;
        let blocked = self.blocked.get_or_insert_with(|| Blocked { end: Box::pin(sleep(limit)), taken: 0 });
        ready!(blocked.end.as_mut().poll(context));
        Poll::Ready(Err(Error::new(ErrorKind::TimedOut, "nobody takes the answer")))
    }
}

impl Drop for Patience {
    /// What nobody takes must not wait in the kernel either, which would keep it for minutes after the
    /// connection is gone from here.
    fn drop(&mut self) {
        if self.blocked.is_some() || self.place.is_lost() {
            // Where this fails there is no connection left.
            let _ = self.stream.set_zero_linger();
        }
    }
}

impl AsyncRead for Patience {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<Result<()>> {
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(context, buffer);
        if buffer.filled().len() > before {
            self.place.heard();
        }
        read
    }
}

impl AsyncWrite for Patience {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.judge(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.judge(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    /// Whoever flushes has written everything.
    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        self.blocked = None;
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
