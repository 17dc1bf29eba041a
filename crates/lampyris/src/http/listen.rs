//! The listener: who may stay connected, and for how long without saying or taking anything.
//!
//! A client has a moment for the head of a request, another for its body (`extract`) and another for taking
//! the answer (`patience`); whoever is slower is closed, and so is a connection that idles. There is a limit
//! of connections, and whoever holds most of them makes room for those that come (`places`).

use super::extract::{SPARE, linger};
use super::origin::authority;
use super::params;
use super::patience::Patience;
use super::places::{Connection, Places};
use super::shared::Shared;
use super::surface::router;
use super::tls::Tls;
use axum::Router;
use axum::body::{Body, Bytes};
use axum::http::{HeaderName, HeaderValue, Request, StatusCode, header};
use axum::response::{IntoResponse, Response};
use hyper::body::{Frame, Incoming, SizeHint};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use std::convert::Infallible;
use std::io::{Error, ErrorKind};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tower::Service as _;

/// A pause where the system gives no connection, such as for want of file descriptors: trying on would burn a
/// core.
const PAUSE: Duration = Duration::from_millis(200);
/// Most bytes of a head, of requests that come before the answer to the last one was taken, and of an answer
/// that waits to be taken, beside bodies that are shared.
const BUFFER: usize = 16 << 10;

/// Says which pages may load an answer as a part of them.
const OWN_PAGES: HeaderName = HeaderName::from_static("cross-origin-resource-policy");

/// Everything that a connection needs to be served.
#[derive(Clone)]
struct Server {
    builder: http1::Builder,
    router: Router,
    service: Shared,
    tls: Option<Arc<Tls>>,
}

/// Serves until the service is asked to stop, and then until the answers under way are sent.
///
/// # Errors
/// None today: what the system refuses is tried again.
pub(crate) async fn listen(
    listener: TcpListener,
    service: Shared,
    tls: Option<Arc<Tls>>,
) -> std::io::Result<()> {
    let limits = service.settings.limits.clone();
    let mut builder = http1::Builder::new();
    builder
        .timer(TokioTimer::new())
        .header_read_timeout(Duration::from_secs(limits.header_seconds))
        .max_buf_size(BUFFER);
    let places = Places::new(limits);
    let router = router(service.clone());
    let mut stopping = service.stopping.subscribe();
    let server = Server { builder, router, service, tls };
    let mut open = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = stopping.wait_for(|stopping| *stopping) => break,
        };
        match accepted {
            Ok((stream, peer)) => {
                let is_open = server.service.tokens.is_open();
                let pause = places.pause(peer.ip(), is_open);
                if !pause.is_zero() {
                    tokio::time::sleep(pause).await;
                }
                let place = places.take(peer.ip(), is_open);
                open.spawn(server.clone().greet(stream, place));
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

impl Server {
    /// Serves one connection to its end, or until others have its place.
    async fn greet(self, stream: TcpStream, place: Arc<Connection>) {
        let limits = &self.service.settings.limits;
        let patience = Duration::from_secs(limits.write_seconds);
        let stream = Patience::new(stream, place.clone(), patience);
        let greeting = Duration::from_secs(limits.header_seconds);
        let served = async {
            match self.tls.as_deref().map(Tls::acceptor) {
                None => self.serve(stream, &place).await,
                // Whoever does not get as far as a request is told nothing.
                Some(acceptor) => {
                    if let Ok(Ok(stream)) = tokio::time::timeout(greeting, acceptor.accept(stream)).await {
                        self.serve(stream, &place).await;
                    }
                }
            }
        };
        tokio::select! {
            biased;
            () = served => {}
            () = place.lost() => {}
        }
    }

    async fn serve(&self, stream: impl AsyncRead + AsyncWrite + Unpin, place: &Arc<Connection>) {
        let answer = service_fn(|mut request: Request<Incoming>| {
            request.extensions_mut().insert(place.clone());
            answer(&self.service, &self.router, request)
        });
        let connection = self.builder.serve_connection(TokioIo::new(stream), answer);
        tokio::pin!(connection);
        let mut stopping: watch::Receiver<bool> = self.service.stopping.subscribe();
        // What goes wrong here is the client's: it is slow, it has gone, or it speaks something else.
        let has_ended = tokio::select! {
            biased;
            _ = connection.as_mut() => true,
            _ = stopping.wait_for(|stopping| *stopping) => false,
        };
        if !has_ended {
            connection.as_mut().graceful_shutdown();
            let _ = connection.await;
        }
    }
}

/// Answers a request that says by which name it asks. Every answer is what it says it is, and no part of a
/// page of another origin.
async fn answer(
    service: &Shared,
    router: &Router,
    request: Request<Incoming>,
) -> Result<Response, Infallible> {
    let (parts, body) = request.into_parts();
    let is_whole = hyper::body::Body::is_end_stream(&body);
    let mut response = match authority(&parts) {
        // Most of all requests; the router takes as long to find the handler as it does to answer.
        Ok(_) if is_whole && params::is_poll(&parts) => {
            params::polled(service, Request::from_parts(parts, Body::empty())).await
        }
        // A router is always ready.
        Ok(_) if is_whole => router.clone().call(Request::from_parts(parts, Body::empty())).await?,
        Ok(_) => Box::pin(with_body(router.clone(), Request::from_parts(parts, body))).await?,
        Err(error) => error.into_response(),
    };
    let fields = response.headers_mut();
    fields.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    fields.insert(OWN_PAGES, HeaderValue::from_static("same-origin"));
    Ok(response)
}

/// Gives a request to the router. It may refuse one before its body has come: what is still under way is
/// thrown away, or else the client that sends it would find the connection closed before it has heard the
/// answer, or at its next request.
async fn with_body(mut router: Router, request: Request<Incoming>) -> Result<Response, Infallible> {
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
