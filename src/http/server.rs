//! The thread that serves the control interface: connections, and what keeps one of them from hurting the others.

use std::collections::HashMap;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tokio::runtime::Builder;
use tokio::sync::{Semaphore, broadcast, mpsc};
use tracing::{debug, warn};

use super::app::{App, Line, Shared};
use super::director::{Director, Kept};
use super::events::{self, Told, WAITING_MAX};
use super::guard::Arrival;
use super::router;
use crate::bus::Bus;
use crate::config::Control;
use crate::image::Layout;
use crate::io::{BusHandle, Watcher};
use crate::journal::Known;
use crate::time::Instant;

/// Most connections at a time; who comes then is told to come later.
const CONNECTIONS_MAX: usize = 64;

/// How long the head of a request may take, also after the one before it.
const HEAD_WITHIN: Duration = Duration::from_secs(20);

/// Orders that wait for the director.
const ORDERS_MAX: usize = 64;

/// How long is waited when the system has no connection to give, because it has too many open.
const BREATH: Duration = Duration::from_millis(100);

/// The control interface before the buses run: it has its port, and learns how everything starts.
pub struct Server {
    control: Control,
    listener: TcpListener,
    listen: SocketAddr,
    events: broadcast::Sender<Told>,
    devices: Vec<Vec<Known>>,
    layouts: HashMap<&'static str, Arc<Layout>>,
    start: Option<Kept>,
}

impl Server {
    /// Takes the port.
    ///
    /// # Errors
    /// It cannot be had.
    pub fn bind(control: &Control) -> io::Result<Self> {
        let listener = TcpListener::bind(control.listen)?;
        listener.set_nonblocking(true)?;
        let listen = listener.local_addr()?;
        let (events, _) = broadcast::channel(WAITING_MAX);
        let (control, layouts) = (control.clone(), HashMap::new());
        Ok(Self { control, listener, listen, events, devices: Vec::new(), layouts, start: None })
    }

    /// Where it listens.
    pub fn url(&self) -> String {
        format!("http://{}", self.listen)
    }

    /// Makes the next bus ready, before it runs: it keeps a journal, and can be brought back to its start. Gives what has
    /// to see the bus' events.
    pub fn attach(&mut self, bus: &mut Bus) -> Watcher {
        let start = Instant(0);
        bus.keep_journal();
        let moment = bus.hold(start);
        let snapshot = bus.snapshot(start);
        bus.resume(start, moment, bus.rate());
        let known = bus.stations().iter().map(|station| {
            let kind = station.kind();
            let layout = self.layouts.entry(kind.name).or_insert_with(|| Arc::new(Layout::new(kind.map)));
            Known { name: station.name().into(), kind, layout: layout.clone(), unit: station.address().unit }
        });
        self.devices.push(known.collect());
        let kept = self.start.get_or_insert_with(|| Kept::start(moment));
        kept.buses.push(snapshot);
        events::watcher(self.devices.len() - 1, self.events.clone())
    }

    /// Serves these buses, which are those that were attached in the same order, on a thread of its own until the program
    /// ends.
    ///
    /// # Errors
    /// The system has no thread to give.
    pub fn start(self, handles: &[BusHandle]) -> io::Result<()> {
        let Self { control, listener, listen, events, devices, start, .. } = self;
        let Some(start) = start else { return Ok(()) };
        let lines = handles.iter().cloned().zip(devices).map(|(handle, devices)| Line { handle, devices });
        let lines: Vec<Line> = lines.collect();
        let runtime = Builder::new_current_thread().enable_all().build()?;
        let serve = async move {
            let (director, orders) = mpsc::channel(ORDERS_MAX);
            tokio::spawn(Director::new(lines.clone(), start, events.clone()).run(orders));
            let app = App::new(Shared { buses: lines, director, events, listen, control });
            accept(listener, router(app)).await
        };
        thread::Builder::new().name("control".into()).spawn(move || {
            if let Err(error) = runtime.block_on(serve) {
                warn!("the control interface has ended: {error}");
            }
        })?;
        Ok(())
    }
}

/// Takes connections for good.
async fn accept(listener: TcpListener, router: Router) -> io::Result<()> {
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    loop {
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                debug!("no connection could be taken: {error}");
                tokio::time::sleep(BREATH).await;
                continue;
            }
        };
        let router = router.clone();
        match places.clone().try_acquire_owned() {
            Ok(place) => {
                tokio::spawn(async move {
                    serve(stream, router).await;
                    drop(place);
                });
            }
            Err(_) => {
                tokio::spawn(turn_away(stream));
            }
        }
    }
}

async fn serve(stream: TcpStream, router: Router) {
    let Ok(address) = stream.local_addr() else { return };
    // A small answer must not wait for the acknowledgement of the one before it.
    if let Err(error) = stream.set_nodelay(true) {
        debug!("a connection stays slow: {error}");
    }
    let service = TowerToHyperService::new(router.layer(Extension(Arrival(address.ip()))));
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD_WITHIN);
    if let Err(error) = http.serve_connection(TokioIo::new(stream), service).await {
        debug!("a connection has ended: {error}");
    }
}

/// Tells a client that there are too many.
async fn turn_away(mut stream: TcpStream) {
    let body = format!(
        "{{\"error\":{{\"code\":\"unavailable\",\"message\":\"{CONNECTIONS_MAX} connections are open; come later\"}}}}"
    );
    let length = body.len();
    let text = format!(
        "HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/json\r\ncontent-length: {length}\r\n\
         connection: close\r\n\r\n{body}"
    );
    // Who does not listen has gone.
    let _ = tokio::time::timeout(Duration::from_secs(1), stream.write_all(text.as_bytes())).await;
}
