//! A peer of the benchmark: tokio-modbus' RTU server with ten holding registers, on one thread.

use std::future::{Ready, ready};

use tokio_modbus::prelude::*;
use tokio_modbus::server::Service;
use tokio_modbus::server::rtu::Server;

struct Registers([u16; 10]);

impl Service for Registers {
    type Request = SlaveRequest<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Self::Request) -> Self::Future {
        ready(match request.request {
            Request::ReadHoldingRegisters(start, count) => {
                let first = usize::from(start);
                let words = self.0.get(first..first + usize::from(count));
                words.map(|words| Response::ReadHoldingRegisters(words.to_vec())).ok_or(ExceptionCode::IllegalDataAddress)
            }
            _ => Err(ExceptionCode::IllegalFunction),
        })
    }
}

fn main() -> std::io::Result<()> {
    let path = std::env::args().nth(1).ok_or_else(|| std::io::Error::other("which port?"))?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let port = tokio_serial::SerialStream::open(&tokio_serial::new(path, 38_400))?;
        Server::new(port).serve_forever(Registers([7; 10])).await
    })
}
