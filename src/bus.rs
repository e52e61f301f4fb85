//! Many stations on one line: bytes in, bytes out.
