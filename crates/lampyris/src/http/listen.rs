//! The listener: who may stay connected, and for how long without saying anything.
//!
//! A client has a moment for the head of a request and another for its body (`extract`); whoever is slower is
//! closed, and so is a connection that idles. There is a limit of connections: beyond it the system lets new
//! ones wait.

use super::access::Peer;
use super::extract::{SPARE, linger};
use super::shared::Shared;
use super::surface::router;
use axum::Router;
use axum::body::{Body, Bytes};
use axum::http::{HeaderValue, Request, StatusCode, header};
use axum::response::Response;
use hyper::body::{Frame, Incoming, SizeHint};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use std::convert::Infallible;
use std::io::{Error, ErrorKind};
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;
use tower::Service as _;

/// A pause where the system gives no connection, such as for want of file descriptors: trying on would burn a
/// core.
const PAUSE: Duration = Duration::from_millis(200);

/// Serves until the service is asked to stop, and then until the answers under way are sent.
///
/// # Errors
/// None today: what the system refuses is tried again.
pub async fn listen(listener: TcpListener, service: Shared) -> std::io::Result<()> {
    let limits = &service.settings.limits;
    let mut builder = http1::Builder::new();
    builder.timer(TokioTimer::new()).header_read_timeout(Duration::from_secs(limits.header_seconds));
    let places = Arc::new(Semaphore::new(limits.connections));
    let router = router(service.clone());
    let mut stopping = service.stopping.subscribe();
    let mut open = JoinSet::new();
    loop {
        let next = async {
            // The semaphore is never closed, so a place is a matter of time.
            let place = places.clone().acquire_owned().await;
            (place, listener.accept().await)
        };
        let (place, accepted) = tokio::select! {
            next = next => next,
            _ = stopping.wait_for(|stopping| *stopping) => break,
        };
        match accepted {
            Ok((stream, peer)) => {
                let serving =
                    serve(builder.clone(), stream, peer.ip(), router.clone(), service.stopping.subscribe());
                open.spawn(async move {
                    serving.await;
                    drop(place);
                });
            }
            // The client has gone before it was heard.
            Err(error) if is_of_the_client(&error) => {}
            Err(error) => {
                tracing::error!(%error, "no connection can be taken");
                tokio::time::sleep(PAUSE).await;
            }
        }
        while open.try_join_next().is_some() {}
    }
    drop(listener);
    while open.join_next().await.is_some() {}
    Ok(())
}

/// Serves one connection to its end.
async fn serve(
    builder: http1::Builder,
    stream: TcpStream,
    peer: IpAddr,
    router: Router,
    mut stopping: watch::Receiver<bool>,
) {
    let answer = service_fn(move |mut request: Request<Incoming>| {
        request.extensions_mut().insert(Peer(peer));
        answer(router.clone(), request)
    });
    let connection = builder.serve_connection(TokioIo::new(stream), answer);
    tokio::pin!(connection);
    // What goes wrong here is the client's: it is slow, it has gone, or it speaks something else.
    let has_ended = tokio::select! {
        _ = connection.as_mut() => true,
        _ = stopping.wait_for(|stopping| *stopping) => false,
    };
    if !has_ended {
        connection.as_mut().graceful_shutdown();
        let _ = connection.await;
    }
}

/// Answers a request. A router may refuse one before its body has come: what is still under way is thrown
/// away, or else the client that sends it would find the connection closed before it has heard the answer, or
/// at its next request.
async fn answer(mut router: Router, request: Request<Incoming>) -> Result<Response, Infallible> {
    // A router is always ready.
    if hyper::body::Body::is_end_stream(request.body()) {
        return router.call(request.map(Body::new)).await;
    }
    // Who asks before sending has nothing under way.
    let asks = request.headers().contains_key(header::EXPECT);
    let (parts, body) = request.into_parts();
    let body = Kept(Arc::new(Mutex::new((body, false))));
    let mut response = router.call(Request::from_parts(parts, Body::new(body.clone()))).await?;
    let has_ended = || hyper::body::Body::is_end_stream(&body);
    if !has_ended() && !asks && response.status() != StatusCode::REQUEST_TIMEOUT {
        linger(Body::new(body.clone()), SPARE).await;
    }
    if !has_ended() {
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    Ok(response)
}

/// The body of a request, which can be read on after its request was answered; and whether it has ended.
#[derive(Clone)]
struct Kept(Arc<Mutex<(Incoming, bool)>>);

impl Kept {
    fn lock(&self) -> MutexGuard<'_, (Incoming, bool)> {
        // After a panic there is still a body to read on, or to give up.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl hyper::body::Body for Kept {
    type Data = Bytes;
    type Error = hyper::Error;

    fn poll_frame(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, hyper::Error>>> {
        let (body, has_ended) = &mut *self.lock();
        let polled = Pin::new(body).poll_frame(cx);
        *has_ended |= matches!(polled, Poll::Ready(None | Some(Err(_))));
        polled
    }

    fn is_end_stream(&self) -> bool {
        let (body, has_ended) = &*self.lock();
        *has_ended || body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.lock().0.size_hint()
    }
}

fn is_of_the_client(error: &Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::ConnectionRefused | ErrorKind::ConnectionAborted | ErrorKind::ConnectionReset
    )
}
