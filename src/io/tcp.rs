//! TCP ports: RTU frames as serial-to-Ethernet adapters carry them, and Modbus TCP. Each client has its own framing, and
//! all see one bus.

use std::io;
use std::net::SocketAddr;
use std::os::fd::AsFd;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use nix::sys::socket::{setsockopt, sockopt};
use tokio::io::{AsyncRead, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::Sleep;
use tracing::{debug, warn};

use super::outbox::Outbox;
use super::port::{Ear, Port};
use crate::bus::{Bus, DoorId, DoorKind};

/// A client that is gone without a word is found out after this and a few probes more.
const KEEP_ALIVE: Duration = Duration::from_secs(60);

/// How long a port that cannot take clients (no descriptors left) waits before it tries again.
const ACCEPT_PAUSE: Duration = Duration::from_secs(1);

/// Unit and function of Modbus TCP follow a header of transaction, protocol and length.
const HEADER: usize = 6;

/// The longest unit and PDU.
const BODY_MAX: usize = 254;

/// What clients of a port send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Framing {
    Rtu,
    Modbus,
}

/// A port that listens.
#[derive(Debug)]
pub struct Tcp {
    listener: TcpListener,
    address: SocketAddr,
    framing: Framing,
    clients: Vec<Client>,
    max_clients: usize,
    pause: Option<Pin<Box<Sleep>>>,
}

#[derive(Debug)]
struct Client {
    stream: TcpStream,
    peer: SocketAddr,
    door: DoorId,
    /// Bytes of Modbus TCP that are no whole request yet, or wait for room.
    inbox: Vec<u8>,
    outbox: Outbox,
    /// It sends no more, but may still listen for replies.
    is_done: bool,
    is_gone: bool,
}

impl Tcp {
    /// Listens for clients that send RTU frames, and serves so many at once.
    ///
    /// # Errors
    /// The address cannot be listened on.
    pub fn open_rtu(address: SocketAddr, max_clients: usize) -> io::Result<Self> {
        Self::open(address, Framing::Rtu, max_clients)
    }

    /// Listens for clients of Modbus TCP, and serves so many at once.
    ///
    /// # Errors
    /// The address cannot be listened on.
    pub fn open_modbus(address: SocketAddr, max_clients: usize) -> io::Result<Self> {
        Self::open(address, Framing::Modbus, max_clients)
    }

    fn open(address: SocketAddr, framing: Framing, max_clients: usize) -> io::Result<Self> {
        // The standard library sets SO_REUSEADDR, so that a restart finds its address free.
        let listener = std::net::TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let listener = TcpListener::from_std(listener)?;
        Ok(Self { listener, address, framing, clients: Vec::new(), max_clients, pause: None })
    }

    fn poll_accept(&mut self, cx: &mut Context<'_>, ear: &mut Ear<'_>) {
        loop {
            if let Some(pause) = &mut self.pause {
                if pause.as_mut().poll(cx) == Poll::Pending {
                    return;
                }
                self.pause = None;
            }
            match self.listener.poll_accept(cx) {
                Poll::Pending => return,
                Poll::Ready(Ok((stream, peer))) => self.welcome(stream, peer, ear),
                Poll::Ready(Err(error)) if is_about_one_client(&error) => {}
                Poll::Ready(Err(error)) => {
                    warn!("{} takes no client for a moment: {error}", self.address);
                    self.pause = Some(Box::pin(tokio::time::sleep(ACCEPT_PAUSE)));
                }
            }
        }
    }

    fn welcome(&mut self, stream: TcpStream, peer: SocketAddr, ear: &mut Ear<'_>) {
        if self.clients.len() >= self.max_clients {
            let count = self.clients.len();
            warn!("{}: {peer} is turned away, max_clients = {count} are there already", self.address);
            return;
        }
        let settings = stream
            .set_nodelay(true)
            // A client that is gone without a word is found out.
            .and_then(|()| Ok(setsockopt(&stream, sockopt::KeepAlive, &true)?))
            .and_then(|()| Ok(setsockopt(&stream, sockopt::TcpKeepIdle, &(KEEP_ALIVE.as_secs() as u32))?));
        if let Err(error) = settings {
            debug!("{}: {peer}: {error}", self.address);
        }
        let kind = match self.framing {
            Framing::Rtu => DoorKind::Virtual,
            Framing::Modbus => DoorKind::Tcp,
        };
        let door = ear.bus.open_door(ear.now, kind);
        let (inbox, outbox) = (Vec::new(), Outbox::default());
        self.clients.push(Client { stream, peer, door, inbox, outbox, is_done: false, is_gone: false });
    }

    fn bury(&mut self, bus: &mut Bus) {
        self.clients.retain(|client| {
            let is_served = client.is_done && client.outbox.is_empty() && !bus.is_asked(client.door);
            let is_over = client.is_gone || is_served;
            if is_over {
                bus.close_door(client.door);
            }
            !is_over
        });
    }
}

/// Errors of accept that leave the listener as it was (accept(2)).
fn is_about_one_client(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionReset, Interrupted, TimedOut};
    matches!(error.kind(), ConnectionAborted | ConnectionReset | Interrupted | TimedOut)
}

impl Client {
    fn poll(&mut self, cx: &mut Context<'_>, framing: Framing, ear: &mut Ear<'_>) -> io::Result<()> {
        while !self.outbox.is_empty() && self.stream.poll_write_ready(cx)?.is_ready() {
            self.outbox.flush(|bytes| self.stream.try_write(bytes))?;
        }
        loop {
            self.hand_in(framing, ear);
            // A client that does not read, or asks faster than it is answered, is made to wait.
            if self.is_done || ear.heard || self.outbox.is_crowded() || !ear.bus.has_room(self.door) {
                return Ok(());
            }
            let mut buffer = ReadBuf::new(ear.buffer);
            if Pin::new(&mut self.stream).poll_read(cx, &mut buffer)?.is_pending() {
                return Ok(());
            }
            let count = buffer.filled().len();
            self.take(count, framing, ear);
        }
    }

    fn take(&mut self, count: usize, framing: Framing, ear: &mut Ear<'_>) {
        match framing {
            _ if count == 0 => {
                self.is_done = true;
                ear.heard = true;
            }
            Framing::Rtu => ear.bytes(self.door, count),
            Framing::Modbus => self.inbox.extend_from_slice(&ear.buffer[..count]),
        }
    }

    /// Hands in whole requests of Modbus TCP, as long as there is room for them.
    fn hand_in(&mut self, framing: Framing, ear: &mut Ear<'_>) {
        if framing == Framing::Rtu {
            return;
        }
        let mut start = 0;
        while let Some((header, rest)) = self.inbox[start..].split_at_checked(HEADER) {
            let [transaction, protocol, length] = [0, 2, 4].map(|at| u16::from_be_bytes([header[at], header[at + 1]]));
            let length = usize::from(length);
            if protocol != 0 || !(2..=BODY_MAX).contains(&length) {
                debug!("{}: it does not talk Modbus TCP", self.peer);
                // What it asked before that is answered.
                self.is_done = true;
                self.inbox.clear();
                return;
            }
            let Some(body) = rest.get(..length).filter(|_| ear.bus.has_room(self.door)) else { break };
            ear.bus.receive_pdu(ear.at, self.door, transaction, body[0], &body[1..]);
            ear.heard = true;
            start += HEADER + length;
        }
        self.inbox.drain(..start);
    }

    fn end(&mut self, error: &io::Error) {
        debug!("{}: {error}", self.peer);
        self.is_gone = true;
    }
}

impl Port for Tcp {
    fn poll_receive(&mut self, cx: &mut Context<'_>, ear: &mut Ear<'_>) -> io::Result<()> {
        self.poll_accept(cx, ear);
        let (framing, heard) = (self.framing, std::mem::take(&mut ear.heard));
        let mut heard_any = heard;
        for client in &mut self.clients {
            if let Err(error) = client.poll(cx, framing, ear) {
                client.end(&error);
            }
            heard_any |= std::mem::take(&mut ear.heard);
        }
        ear.heard = heard_any;
        self.bury(ear.bus);
        Ok(())
    }

    fn look(&mut self, ear: &mut Ear<'_>) -> io::Result<()> {
        let rtu = self.clients.iter_mut().filter(|client| !client.is_done);
        for client in rtu.filter(|_| self.framing == Framing::Rtu) {
            if !ear.bus.has_room(client.door) {
                continue;
            }
            match nix::unistd::read(client.stream.as_fd(), ear.buffer) {
                Ok(count) => client.take(count, Framing::Rtu, ear),
                Err(nix::errno::Errno::EAGAIN | nix::errno::Errno::EINTR) => {}
                Err(errno) => client.end(&errno.into()),
            }
        }
        Ok(())
    }

    fn has_door(&self, door: DoorId) -> bool {
        self.clients.iter().any(|client| client.door == door)
    }

    fn transmit(&mut self, door: DoorId, transaction: Option<u16>, bytes: &[u8]) -> io::Result<()> {
        let Some(client) = self.clients.iter_mut().find(|client| client.door == door) else { return Ok(()) };
        let Client { outbox, stream, .. } = client;
        let write = |bytes: &[u8]| stream.try_write(bytes);
        let sent = match transaction {
            None => outbox.send(bytes, write),
            Some(transaction) => {
                let header = [transaction, 0, bytes.len() as u16].map(u16::to_be_bytes);
                outbox.send(&[header.as_flattened(), bytes].concat(), write)
            }
        };
        if let Err(error) = sent {
            client.end(&error);
        }
        Ok(())
    }

    fn is_sending(&self) -> bool {
        self.clients.iter().any(|client| !client.outbox.is_empty())
    }

    fn close(&mut self, bus: &mut Bus) {
        for client in &self.clients {
            bus.close_door(client.door);
        }
    }

    fn path(&self) -> String {
        self.address.to_string()
    }
}
