//! Who may ask (CTL-1): pages of other sites in a browser on this computer may not, and where there is a token, only
//! those who show it.

use std::net::IpAddr;

use axum::Extension;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, header};
use axum::middleware::Next;
use axum::response::Response;
use subtle::ConstantTimeEq;

use super::app::App;
use super::error::ApiError;

/// The address of this computer that a connection came in by.
#[derive(Clone, Copy, Debug)]
pub struct Arrival(pub IpAddr);

/// Lets a request through, or answers it.
pub async fn check(
    State(app): State<App>,
    Extension(Arrival(arrival)): Extension<Arrival>,
    request: Request,
    next: Next,
) -> Result<Response, ApiError> {
    let headers = request.headers();
    let host = only(headers, &header::HOST)?;
    // A request line may carry the host itself, and then it is what counts.
    let host = request.uri().authority().map_or(host, |authority| Some(authority.as_str()));
    match host {
        None => return Err(ApiError::foreign("the request has no Host (CTL-1)")),
        Some(host) if !is_ours(&app, host, arrival) => return Err(foreign("Host", host)),
        Some(_) => {}
    }
    if let Some(origin) = only(headers, &header::ORIGIN)? {
        let host = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
        if !host.is_some_and(|host| is_ours(&app, host, arrival)) {
            return Err(foreign("Origin", origin));
        }
    }
    if let Some(token) = &app.control.token {
        let shown = only(headers, &header::AUTHORIZATION)?.and_then(bearer);
        if !shown.is_some_and(|shown| bool::from(shown.as_bytes().ct_eq(token.as_bytes()))) {
            return Err(ApiError::no_token());
        }
    }
    Ok(next.run(request).await)
}

fn foreign(header: &str, value: &str) -> ApiError {
    ApiError::foreign(format!(
        "the {header} {value:?} is neither this address nor localhost nor one of [control] hosts (CTL-1)"
    ))
}

/// The value of a header that may come once.
fn only<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Result<Option<&'a str>, ApiError> {
    let mut values = headers.get_all(name).iter();
    match (values.next(), values.next()) {
        (None, _) => Ok(None),
        (Some(value), None) => {
            value.to_str().map(Some).map_err(|_| ApiError::unreadable(format!("the header {name} is not readable")))
        }
        (Some(_), Some(_)) => Err(ApiError::unreadable(format!("the header {name} comes more than once"))),
    }
}

fn bearer(value: &str) -> Option<&str> {
    let (scheme, token) = value.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then_some(token.trim())
}

/// Whether a host, with or without a port, is this computer by the name that the user gave it. Ports do not matter: they
/// change on the way through tunnels, and a page of another site cannot choose the name.
fn is_ours(app: &App, host: &str, arrival: IpAddr) -> bool {
    let name = without_port(host).to_ascii_lowercase();
    let name = name.strip_suffix('.').unwrap_or(&name);
    if name == "localhost" || app.control.hosts.iter().any(|ours| ours == name) {
        return true;
    }
    let bare = name.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(name);
    bare.parse().is_ok_and(|ip: IpAddr| {
        let ip = ip.to_canonical();
        ip == app.listen.ip().to_canonical() && !ip.is_unspecified() || ip == arrival.to_canonical() || ip.is_loopback()
    })
}

fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port))
            if !name.is_empty() && !port.contains(']') && port.bytes().all(|byte| byte.is_ascii_digit()) =>
        {
            name
        }
        _ => host,
    }
}
