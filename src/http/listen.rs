//! The listener: who may stay connected, and for how long without saying anything.
//!
//! A client has a moment for the head of a request and another for its body (`extract`); whoever is slower is closed,
//! and so is a connection that idles. There is a limit of connections: beyond it the system lets new ones wait.

use super::Shared;
use axum::Router;
use axum::body::Body;
use axum::http::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use std::io::{Error, ErrorKind};
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;
use tower::Service as _;

/// A pause where the system gives no connection, such as for want of file descriptors: trying on would burn a core.
const PAUSE: Duration = Duration::from_millis(200);

/// The address that a request came from.
#[derive(Debug, Clone, Copy)]
pub struct Peer(pub IpAddr);

/// Serves until the service is asked to stop, and then until the answers under way are sent.
///
/// # Errors
/// None today: what the system refuses is tried again.
pub async fn listen(listener: TcpListener, service: Shared) -> std::io::Result<()> {
    let limits = &service.settings.limits;
    let mut builder = http1::Builder::new();
    builder.timer(TokioTimer::new()).header_read_timeout(Duration::from_secs(limits.header_seconds));
    let places = Arc::new(Semaphore::new(limits.connections));
    let router = super::router(service.clone());
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
                let serving = serve(builder.clone(), stream, peer.ip(), router.clone(), service.stopping.subscribe());
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
async fn serve(builder: http1::Builder, stream: TcpStream, peer: IpAddr, router: Router, mut stopping: watch::Receiver<bool>) {
    let answer = service_fn(move |request: Request<Incoming>| {
        let mut request = request.map(Body::new);
        request.extensions_mut().insert(Peer(peer));
        // A router is always ready.
        router.clone().call(request)
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

fn is_of_the_client(error: &Error) -> bool {
    matches!(error.kind(), ErrorKind::ConnectionRefused | ErrorKind::ConnectionAborted | ErrorKind::ConnectionReset)
}
