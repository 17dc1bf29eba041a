//! Puts the service together: database, catalogue, snapshot, workers, schedule, then the listener.

use crate::http;
use crate::service::access::tokens::{self, Tokens};
use crate::service::catalogue::kept_posts::KeptPosts;
use crate::service::catalogue::open;
use crate::service::catalogue::shared::SharedCatalogue;
use crate::service::catalogue::turns::Turns;
use crate::service::changes::events::Events;
use crate::service::changes::{fleet, follow, notify};
use crate::service::observe::lines::LineTally;
use crate::service::observe::metrics::Metrics;
use crate::service::observe::pulls::Pulls;
use crate::service::queue::listing;
use crate::service::queue::schedules;
use crate::service::serving::arrivals::Arrivals;
use crate::service::serving::kept::LiveSystems;
use crate::service::serving::said::SaidForecasts;
use crate::service::serving::snapshot::Snapshot;
use crate::service::serving::{degradations, keeping, params, pull};
use crate::service::work::board::ProgressBoard;
use crate::service::work::interactive::Interactive;
use crate::service::work::membership::Membership;
use crate::service::work::renewal;
use crate::service::work::worker;
use crate::service::{Clock, Service, ServiceError, pool};
use crate::settings::Settings;
use crate::store::workers::ProcessRole;
use crate::store::{self, Store, StoreError, feed, workers};
use jiff::Timestamp;
use lampyris_core::model::Catalogue;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::time::Duration;
use tokio::net::{TcpListener, TcpSocket};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::{Notify, watch};
use tokio::task::{JoinHandle, JoinSet};

/// How long jobs and answers under way may take after the service was asked to stop. Five seconds are
/// promised.
const GRACE: Duration = Duration::from_secs(4);
/// How often the files of the database are looked at while nobody writes.
const LOOK: Duration = Duration::from_secs(1);
/// Files beside those of connections: the database, the log, the runtime.
const SPARE_FILES: u64 = 128;

/// What the start or the end of a service comes to. In a box it is compiled here once, and not, with all that
/// it waits for, in every program that asks for it.
pub type AppFuture<T> = Pin<Box<dyn Future<Output = Result<T, AppError>> + Send>>;

/// A running service.
#[derive(Debug)]
pub struct App {
    /// Where it listens.
    pub addr: SocketAddr,
    service: Arc<Service>,
    tls: Option<Arc<http::Tls>>,
    server: JoinHandle<std::io::Result<()>>,
    tasks: JoinSet<()>,
}

/// Why the service did not start, or did not stop cleanly.
#[derive(Debug)]
pub enum AppError {
    /// The settings make no sense.
    Settings(Vec<lampyris_core::fault::Fault>),
    /// Where there are no tokens, whoever can reach the address can do everything: that may be this machine
    /// alone.
    NotLoopback(SocketAddr),
    /// The certificate cannot be used.
    Tls(String),
    /// The address cannot be listened on.
    Bind(SocketAddr, std::io::Error),
    /// The built-in documents cannot be read.
    Catalogue(Vec<lampyris_core::fault::Fault>),
    /// The database cannot be used.
    Store(StoreError),
    /// What is served could not be prepared.
    Prepare(ServiceError),
    /// The system gives no threads.
    Threads(rayon::ThreadPoolBuildError),
    /// The listener or a signal failed.
    Io(std::io::Error),
}

impl std::fmt::Display for AppError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let list = |f: &mut std::fmt::Formatter<'_>, faults: &[lampyris_core::fault::Fault]| {
            faults.iter().try_for_each(|fault| write!(f, "\n  {fault}"))
        };
        match self {
            AppError::Settings(faults) => {
                f.write_str("the settings have faults:")?;
                list(f, faults)
            }
            AppError::NotLoopback(addr) => {
                write!(
                    f,
                    "{addr} can be reached from other machines, and there are no tokens: make one first, \
                    with\n  \
                    lampyris token create --name NAME --scope admin --database FILE\nor bind to 127.0.0.1"
                )
            }
            AppError::Tls(error) => write!(f, "the certificate cannot be used: {error}"),
            AppError::Bind(addr, error) => write!(f, "cannot listen on {addr}: {error}"),
            AppError::Catalogue(faults) => {
                f.write_str("the built-in documents have faults:")?;
                list(f, faults)
            }
            AppError::Store(error) => error.fmt(f),
            AppError::Prepare(error) => write!(f, "what is served could not be prepared: {error}"),
            AppError::Threads(error) => write!(f, "no threads for jobs: {error}"),
            AppError::Io(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for AppError {}

impl From<StoreError> for AppError {
    fn from(error: StoreError) -> Self {
        AppError::Store(error)
    }
}

impl From<ServiceError> for AppError {
    fn from(error: ServiceError) -> Self {
        AppError::Prepare(error)
    }
}

impl App {
    /// Starts a service inside this process.
    ///
    /// # Errors
    /// Where anything that it needs is missing; then nothing of it runs.
    pub fn start(settings: Settings) -> AppFuture<App> {
        Self::start_by(settings, Clock::default())
    }

    /// Starts a service that lives by this clock.
    ///
    /// # Errors
    /// As [`App::start`].
    pub fn start_by(settings: Settings, clock: Clock) -> AppFuture<App> {
        Box::pin(Self::started(settings, clock))
    }

    async fn started(settings: Settings, clock: Clock) -> Result<App, AppError> {
        let faults = settings.faults();
        if !faults.is_empty() {
            return Err(AppError::Settings(faults));
        }
        let tls = settings.tls.clone().map(http::Tls::load).transpose().map_err(AppError::Tls)?;
        let builtin = Catalogue::builtin().map_err(AppError::Catalogue)?;
        let store = Store::open(&settings.database, settings.limits.quota()).await?;
        let tokens = Tokens::load(&store).await?;
        if tokens.is_open() && !settings.bind.ip().is_loopback() {
            return Err(AppError::NotLoopback(settings.bind));
        }
        // Taken before anything ends, so that the jobs that fail right now are told and counted like all
        // others.
        let newest = store::events::newest(&store).await?;
        let (store, membership) = begun(&settings, store, clock.now()).await?;
        let boot = membership.worker();
        let service = Arc::new(Service {
            catalogue: SharedCatalogue::load(&store, builtin).await?,
            board: ProgressBoard::default(),
            interactive: Interactive::new(threads(&settings)).map_err(AppError::Threads)?,
            inquiries: Interactive::of_seconds(threads(&settings)).map_err(AppError::Threads)?,
            events: Events::new(boot, newest),
            tokens,
            metrics: Metrics::new(clock.now()),
            lines: LineTally::default(),
            params: Snapshot::default(),
            arrivals: Arrivals::default(),
            live: LiveSystems::default(),
            said: SaidForecasts::default(),
            turns: Turns::default(),
            kept_posts: KeptPosts::default(),
            pulls: Pulls::default(),
            wake: Notify::new(),
            wake_schedule: Notify::new(),
            stopping: watch::Sender::new(false),
            workers_alive: AtomicUsize::new(0),
            abandoned: watch::Sender::new(0),
            settings,
            store,
            clock,
            membership,
        });
        // Nobody may ask before what is served is in memory, and nothing that is committed after it was read
        // may be missed.
        let mut tasks = JoinSet::new();
        let changes = service.store.follow();
        let place = if service.store.is_shared() { feed::newest(&service.store).await? } else { 0 };
        let ageing = params::load_all(&service).await?;
        tasks.spawn(params::follow(service.clone(), changes, ageing));
        let bind = service.settings.bind;
        let listener =
            bound(bind, service.settings.limits.connections).map_err(|error| AppError::Bind(bind, error))?;
        let addr = listener.local_addr().map_err(AppError::Io)?;
        if !service.store.is_read_only() {
            match schedules::ensure_nightly(&service).await {
                Err(ServiceError::Store(error)) if error.is_unwritable() => {
                    tracing::warn!(%error, "there is no nightly schedule yet");
                }
                ensured => ensured?,
            }
            let workers =
                if service.settings.has(ProcessRole::Worker) { service.settings.workers } else { 0 };
            for index in 0..workers {
                let pool = pool(threads(&service.settings), index).map_err(AppError::Threads)?;
                tasks.spawn(worker::run(service.clone(), pool, index));
            }
            if service.settings.has(ProcessRole::Scheduler) {
                let spare = pool(1, service.settings.workers).map_err(AppError::Threads)?;
                tasks.spawn(degradations::run(service.clone(), spare));
                tasks.spawn(schedules::run(service.clone()));
                tasks.spawn(open::run(service.clone()));
                tasks.spawn(pull::run(service.clone()));
                tasks.spawn(notify::run(service.clone()));
                tasks.spawn(listing::run(service.clone()));
            }
            tasks.spawn(keeping::run(service.clone()));
            if service.store.is_shared() {
                tasks.spawn(renewal::keep(service.clone()));
                tasks.spawn(fleet::follow(service.clone(), place));
            } else {
                tasks.spawn(watch_files(service.clone()));
            }
        }
        tasks.spawn(follow::follow(service.clone()));
        let following = service.clone();
        tasks.spawn(async move {
            tokens::follow(&following.tokens, &following.store, following.stopping.subscribe()).await
        });
        if let Some(tls) = &tls {
            tasks.spawn(tls.clone().follow(service.stopping.subscribe()));
        }
        let server = tokio::spawn(http::listen(listener, service.clone(), tls.clone()));
        let app = App { addr, service, tls, server, tasks };
        tracing::info!(%addr, boot, "listening on {}", app.url());
        Ok(app)
    }

    /// Where it can be asked.
    pub fn url(&self) -> String {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        format!("{scheme}://{}", self.addr)
    }

    /// What handlers and workers share, for callers in the same process.
    pub fn service(&self) -> &Service {
        &self.service
    }

    /// Stops: jobs under way go back to the queue without a charge, answers under way are sent.
    ///
    /// # Errors
    /// Where the listener had failed.
    pub fn shutdown(self) -> AppFuture<()> {
        Box::pin(self.ended())
    }

    async fn ended(mut self) -> Result<(), AppError> {
        self.service.stopping.send_replace(true);
        self.service.wake.notify_waiters();
        let tasks = async { while self.tasks.join_next().await.is_some() {} };
        let (tasks_done, server_done) =
            tokio::join!(tokio::time::timeout(GRACE, tasks), tokio::time::timeout(GRACE, &mut self.server));
        if tasks_done.is_err() {
            // A job that did not hear in time is given back over its head; its own end will find the lease
            // gone.
            for lease in self.service.board.leases() {
                if let Err(error) =
                    store::queue::requeue(&self.service.store, &lease, self.service.now()).await
                {
                    tracing::error!(%error, job = lease.job, "a job could not be given back");
                }
            }
            self.tasks.abort_all();
        }
        if self.service.store.is_shared()
            && let Err(error) = workers::dismiss(&self.service.store, self.service.membership.worker()).await
        {
            tracing::warn!(%error, "this process could not take its leave");
        }
        self.service.store.close().await;
        match server_done {
            Ok(Ok(result)) => result.map_err(AppError::Io),
            // A client that reads slowly does not hold up the end.
            Ok(Err(_)) | Err(_) => {
                self.server.abort();
                Ok(())
            }
        }
    }
}

/// Runs a service until SIGTERM or SIGINT. SIGHUP makes it look at its certificate; settings are read at a
/// start alone.
///
/// # Errors
/// Where it cannot start, or its listener fails.
pub async fn serve(settings: Settings, ready: impl FnOnce(&str)) -> Result<(), AppError> {
    let mut terminate = signal(SignalKind::terminate()).map_err(AppError::Io)?;
    let mut interrupt = signal(SignalKind::interrupt()).map_err(AppError::Io)?;
    let mut hangup = signal(SignalKind::hangup()).map_err(AppError::Io)?;
    allow_files(settings.limits.connections);
    let app = App::start(settings).await?;
    ready(&app.url());
    loop {
        tokio::select! {
            _ = terminate.recv() => break,
            _ = interrupt.recv() => break,
            _ = hangup.recv() => {
                if let Some(tls) = &app.tls {
                    tls.renew();
                }
            }
        }
    }
    tracing::info!("asked to stop");
    app.shutdown().await
}

/// Begins to work, unless nothing can be written. The opening may have taken the last room that a disk had.
async fn begun(settings: &Settings, store: Store, now: Timestamp) -> Result<(Store, Membership), StoreError> {
    if store.is_read_only() {
        return Ok((store, Membership::none()));
    }
    match (begin(&store, settings, now).await, settings.database.file()) {
        (Err(error), Some(path)) if error.is_unwritable() => {
            Ok((store.without_writing(path, &error).await?, Membership::none()))
        }
        (membership, _) => Ok((store, membership?)),
    }
}

/// Enters this process, and clears up after those that are gone.
async fn begin(store: &Store, settings: &Settings, now: Timestamp) -> Result<Membership, StoreError> {
    let membership = Membership::enter(store, settings, now).await?;
    renewal::recover(store, now).await?;
    store::idempotency::forget_old(store, now).await?;
    Ok(membership)
}

/// Looks at the files of the database until the service stops, also while nobody writes. What can be saved of
/// them is saved once.
async fn watch_files(service: Arc<Service>) {
    let mut stopping = service.stopping.subscribe();
    while service.store.require_files().is_ok() {
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            _ = stopping.wait_for(|stopping| *stopping) => return,
        }
    }
    if let Err(error) = service.store.save().await {
        tracing::error!(%error, "the write-ahead log could not be saved");
    }
}

/// Lets this process have as many files open as its connections need, as far as the system allows.
fn allow_files(connections: usize) {
    let needed = connections as u64 + SPARE_FILES;
    let limit = getrlimit(Resource::Nofile);
    let allowed = limit.maximum.map_or(needed, |most| most.min(needed));
    if limit.current.is_some_and(|current| current < allowed)
        && let Err(error) = setrlimit(Resource::Nofile, Rlimit { current: Some(allowed), ..limit })
    {
        tracing::warn!(%error, "the number of open files stays as it is");
    }
}

/// Bytes of answers that wait in the system for one connection to take them.
const SEND_BUFFER: u32 = 256 << 10;

/// A listener with a queue for as many connections as may be open, and at least a thousand: with the usual
/// 128, a crowd that arrives at once waits a second for the system to try again.
fn bound(address: SocketAddr, connections: usize) -> std::io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    // As a restart finds connections of the last life that the system has not forgotten yet.
    socket.set_reuseaddr(true)?;
    // Connections inherit it. Left to itself the system would keep up to 4 MiB for each that takes nothing.
    socket.set_send_buffer_size(SEND_BUFFER)?;
    socket.bind(address)?;
    socket.listen(u32::try_from(connections).unwrap_or(u32::MAX).clamp(1_024, i32::MAX as u32))
}

/// CPU threads of one worker.
fn threads(settings: &Settings) -> usize {
    match settings.threads {
        0 => std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
        threads => threads,
    }
}
