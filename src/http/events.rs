//! `GET /api/events`: what happens on the buses while it happens, as server-sent events.
//!
//! The buses hand their events to a channel that never waits: a reader that does not keep up loses the oldest and is told
//! how many.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::response::sse::{Event as Sse, KeepAlive};
use axum::response::{IntoResponse, Response};
use futures_util::stream::{self, Stream};
use serde::Serialize;
use serde_json::{Value, json};
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::sync::broadcast::{self, Receiver};

use super::app::App;
use super::clock::{civil_text, elapsed_s};
use super::devices::value_of;
use super::director::Order;
use super::error::{ApiError, Failure};
use super::journal::{ExchangeView, hex};
use crate::bus::{Event, Exchange, Output};
use crate::io::Watcher;
use crate::time::Moment;

/// Something that happened on the bus of an index.
#[derive(Clone, Debug)]
pub enum Told {
    /// A request and what came of it.
    Exchange(usize, Arc<Exchange>),
    /// Something else.
    Event(usize, Arc<Event>),
}

/// Events that wait for a reader before the oldest are lost.
pub const WAITING_MAX: usize = 1024;

/// The most events that a reader gets in a row.
const IN_A_ROW_MAX: usize = 256;

/// The pause behind events in a row: a bus that is asked as fast as it answers must not spend its time on waking its readers
/// for each event.
const PAUSE: Duration = Duration::from_millis(4);

/// How often a stream says that it is still there.
const ALIVE_EVERY: Duration = Duration::from_secs(15);

/// What hands the events of the bus of an index on to those who follow them.
pub fn watcher(index: usize, events: broadcast::Sender<Told>) -> Watcher {
    Box::new(move |_, output| {
        if events.receiver_count() == 0 {
            return;
        }
        let told = match output {
            Output::Exchange(exchange) => Told::Exchange(index, exchange.clone()),
            Output::Event(event) => Told::Event(index, Arc::new(event.clone())),
            _ => return,
        };
        // The last reader may just have gone.
        let _ = events.send(told);
    })
}

/// Follows what happens: `exchange` (as in the journal, without number and hint), `change` of a register, `boot`,
/// `power`, `fault` hit, and `lost` where this reader did not keep up.
#[utoipa::path(get, path = "/api/events", tag = "journal", operation_id = "events",
    responses((status = 200, description = "Server-sent events; the data of each is JSON", content_type = "text/event-stream",
            body = String),
        (status = "default", body = Failure, description = "An error")))]
pub async fn follow(State(app): State<App>) -> Result<Response, ApiError> {
    let receiver = app.events.subscribe();
    Order::send(&app.director, Order::Watch).await?;
    let alive = KeepAlive::new().interval(ALIVE_EVERY);
    Ok(axum::response::Sse::new(events(app, receiver)).keep_alive(alive).into_response())
}

/// Somebody who follows the events.
struct Follower {
    app: App,
    receiver: Receiver<Told>,
    ready: VecDeque<Sse>,
    /// Events since the last pause.
    in_a_row: usize,
}

impl Follower {
    /// What comes next; `None` when the program ends.
    async fn next(&mut self) -> Option<Sse> {
        loop {
            if let Some(ready) = self.ready.pop_front() {
                return Some(ready);
            }
            if self.in_a_row == IN_A_ROW_MAX {
                self.pause().await;
            }
            let told = match self.receiver.try_recv() {
                Err(TryRecvError::Empty) if self.in_a_row > 0 => {
                    self.pause().await;
                    continue;
                }
                Err(TryRecvError::Empty) => self.receiver.recv().await,
                Ok(told) => Ok(told),
                Err(TryRecvError::Lagged(count)) => Err(RecvError::Lagged(count)),
                Err(TryRecvError::Closed) => return None,
            };
            self.in_a_row += 1;
            match told {
                Ok(told) => tell(&self.app, &told, &mut self.ready),
                Err(RecvError::Lagged(count)) => self.ready.push_back(event("lost", &json!({ "count": count }))),
                Err(RecvError::Closed) => return None,
            }
        }
    }

    async fn pause(&mut self) {
        self.in_a_row = 0;
        tokio::time::sleep(PAUSE).await;
    }
}

fn events(app: App, receiver: Receiver<Told>) -> impl Stream<Item = Result<Sse, Infallible>> {
    let ready = VecDeque::from([Sse::default().comment("standin")]);
    let follower = Follower { app, receiver, ready, in_a_row: 0 };
    stream::unfold(follower, |mut follower| async move {
        let next = follower.next().await?;
        Some((Ok(next), follower))
    })
}

fn event(name: &str, data: &impl Serialize) -> Sse {
    // Structs of text and numbers always have a JSON form.
    Sse::default().event(name).data(serde_json::to_string(data).unwrap_or_default())
}

fn tell(app: &App, told: &Told, ready: &mut VecDeque<Sse>) {
    match told {
        Told::Exchange(index, exchange) => {
            let line = &app.buses[*index];
            let bus = &line.handle.name;
            let view = ExchangeView::new(bus, &line.devices, exchange);
            ready.push_back(event("exchange", &view));
            ready.extend(exchange.faults.iter().map(|hit| {
                event("fault", &json!({ "bus": bus, "id": hit.id, "kind": hit.kind, "device": view.device }))
            }));
        }
        Told::Event(index, told) => ready.push_back(told_event(app, *index, told)),
    }
}

fn told_event(app: &App, index: usize, told: &Event) -> Sse {
    let line = &app.buses[index];
    let head = |at: &Moment, station: Option<usize>| {
        json!({
            "bus": line.handle.name,
            "device": station.map(|station| line.devices[station].name.clone()),
            "elapsed_s": elapsed_s(*at),
            "now": civil_text(at.civil),
        })
    };
    let with = |mut head: Value, more: Value| {
        if let (Value::Object(head), Value::Object(more)) = (&mut head, more) {
            head.extend(more);
        }
        head
    };
    match told {
        Event::Change { at, station, member, scale, before, after } => {
            let more = json!({
                "register": member.name(),
                "raw": after,
                "value": value_of(*member, *scale, *after),
                "unit": member.row.unit,
                "was_raw": before,
                "was": value_of(*member, *scale, *before),
            });
            event("change", &with(head(at, Some(*station)), more))
        }
        Event::Boot { at, station, boots } => event("boot", &with(head(at, Some(*station)), json!({ "boots": boots }))),
        Event::Power { at, station, is_powered } => {
            event("power", &with(head(at, Some(*station)), json!({ "powered": is_powered })))
        }
        Event::Noise { at, hit, bytes } => {
            let more = json!({ "id": hit.id, "kind": hit.kind, "bytes": hex(bytes) });
            event("fault", &with(head(at, None), more))
        }
    }
}
