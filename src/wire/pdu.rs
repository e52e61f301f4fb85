//! Function codes, requests and exceptions of the Modbus application protocol.

use std::fmt;

use crate::map::Bank;

/// Function codes that the protocol engine understands; the others are only known by number.
pub mod function {
    /// Read coils.
    pub const READ_COILS: u8 = 0x01;
    /// Read discrete inputs.
    pub const READ_DISCRETE_INPUTS: u8 = 0x02;
    /// Read holding registers.
    pub const READ_HOLDING_REGISTERS: u8 = 0x03;
    /// Read input registers.
    pub const READ_INPUT_REGISTERS: u8 = 0x04;
    /// Write one coil.
    pub const WRITE_SINGLE_COIL: u8 = 0x05;
    /// Write one holding register.
    pub const WRITE_SINGLE_REGISTER: u8 = 0x06;
    /// Write several coils.
    pub const WRITE_MULTIPLE_COILS: u8 = 0x0F;
    /// Write several holding registers.
    pub const WRITE_MULTIPLE_REGISTERS: u8 = 0x10;
}

/// What a function code is called.
pub fn function_name(code: u8) -> &'static str {
    match code & 0x7F {
        function::READ_COILS => "read coils",
        function::READ_DISCRETE_INPUTS => "read discrete inputs",
        function::READ_HOLDING_REGISTERS => "read holding registers",
        function::READ_INPUT_REGISTERS => "read input registers",
        function::WRITE_SINGLE_COIL => "write single coil",
        function::WRITE_SINGLE_REGISTER => "write single register",
        function::WRITE_MULTIPLE_COILS => "write multiple coils",
        function::WRITE_MULTIPLE_REGISTERS => "write multiple registers",
        _ => "other function",
    }
}

/// An exception code: what the wire may see of an error (BUS-8).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Exception {
    /// 01: the device does not support the function.
    IllegalFunction = 1,
    /// 02: an address that the device does not have, or may not write.
    IllegalDataAddress = 2,
    /// 03: a quantity or a value that the device refuses.
    IllegalDataValue = 3,
    /// 04: the device cannot carry it out.
    DeviceFailure = 4,
}

impl fmt::Display for Exception {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self {
            Exception::IllegalFunction => "illegal function",
            Exception::IllegalDataAddress => "illegal data address",
            Exception::IllegalDataValue => "illegal data value",
            Exception::DeviceFailure => "device failure",
        };
        write!(out, "{:02} {name}", *self as u8)
    }
}

/// A request's function and data, without unit and CRC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request<'a> {
    /// Functions 01 to 04.
    Read {
        /// What is read.
        bank: Bank,
        /// First address.
        start: u16,
        /// How many bits or registers.
        quantity: u16,
    },
    /// Functions 05 and 06.
    WriteSingle {
        /// Coil or holding register.
        bank: Bank,
        /// The address.
        addr: u16,
        /// The value as sent; a coil's is 0xFF00 or 0x0000, or wrong.
        value: u16,
    },
    /// Functions 15 and 16.
    WriteMultiple {
        /// Coil or holding register.
        bank: Bank,
        /// First address.
        start: u16,
        /// How many bits or registers.
        quantity: u16,
        /// The data behind the byte count, all of it.
        data: &'a [u8],
    },
    /// Any other function.
    Other {
        /// Its code.
        function: u8,
    },
}

impl<'a> Request<'a> {
    /// Reads function and data; `None` where a known function's body has the wrong length (BUS-12).
    pub fn parse(pdu: &'a [u8]) -> Option<Self> {
        let (&code, body) = pdu.split_first()?;
        let two = |at: usize| -> Option<u16> { Some(u16::from_be_bytes([*body.get(at)?, *body.get(at + 1)?])) };
        let bank = match code {
            function::READ_COILS | function::WRITE_SINGLE_COIL | function::WRITE_MULTIPLE_COILS => Bank::Coil,
            function::READ_DISCRETE_INPUTS => Bank::Discrete,
            function::READ_INPUT_REGISTERS => Bank::Input,
            function::READ_HOLDING_REGISTERS | function::WRITE_SINGLE_REGISTER | function::WRITE_MULTIPLE_REGISTERS => {
                Bank::Holding
            }
            _ => return Some(Request::Other { function: code }),
        };
        let (first, second) = (two(0)?, two(2)?);
        match code {
            function::READ_COILS..=function::READ_INPUT_REGISTERS if body.len() == 4 => {
                Some(Request::Read { bank, start: first, quantity: second })
            }
            function::WRITE_SINGLE_COIL | function::WRITE_SINGLE_REGISTER if body.len() == 4 => {
                Some(Request::WriteSingle { bank, addr: first, value: second })
            }
            function::WRITE_MULTIPLE_COILS | function::WRITE_MULTIPLE_REGISTERS => {
                let (&count, data) = body.get(4..)?.split_first()?;
                let whole = data.len() == usize::from(count);
                whole.then_some(Request::WriteMultiple { bank, start: first, quantity: second, data })
            }
            _ => None,
        }
    }

    /// The function code.
    pub fn function(&self) -> u8 {
        match *self {
            Request::Read { bank: Bank::Coil, .. } => function::READ_COILS,
            Request::Read { bank: Bank::Discrete, .. } => function::READ_DISCRETE_INPUTS,
            Request::Read { bank: Bank::Input, .. } => function::READ_INPUT_REGISTERS,
            Request::Read { bank: Bank::Holding, .. } => function::READ_HOLDING_REGISTERS,
            Request::WriteSingle { bank: Bank::Coil, .. } => function::WRITE_SINGLE_COIL,
            Request::WriteSingle { .. } => function::WRITE_SINGLE_REGISTER,
            Request::WriteMultiple { bank: Bank::Coil, .. } => function::WRITE_MULTIPLE_COILS,
            Request::WriteMultiple { .. } => function::WRITE_MULTIPLE_REGISTERS,
            Request::Other { function } => function,
        }
    }

    /// Whether it only reads.
    pub fn is_read(&self) -> bool {
        matches!(self, Request::Read { .. })
    }
}
