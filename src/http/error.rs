//! What a call answers when it cannot be done (CTL-2).

use axum::Json;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use crate::device::Refusal;

/// A call that was not done.
#[derive(Debug, Serialize, ToSchema)]
pub struct Failure {
    /// What went wrong.
    pub error: Problem,
}

/// What went wrong.
#[derive(Debug, Serialize, ToSchema)]
pub struct Problem {
    /// A word for programs.
    #[schema(example = "refused")]
    pub code: &'static str,
    /// A sentence for people; where a rule refuses, in the rule's own words and with its clause.
    pub message: String,
    /// The field that is meant, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
}

/// Why a call is not done.
#[derive(Debug)]
pub struct ApiError {
    status: StatusCode,
    problem: Problem,
}

impl ApiError {
    fn new(status: StatusCode, code: &'static str, message: impl Into<String>) -> Self {
        Self { status, problem: Problem { code, message: message.into(), field: None } }
    }

    /// 400: the body or query cannot be read.
    pub fn unreadable(message: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "not_readable", message)
    }

    /// 400: a field that the call does not have.
    pub fn unknown_field(field: &str, message: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "unknown_field", message).of(field)
    }

    /// 401: no token, or a wrong one.
    pub fn no_token() -> Self {
        let message = "this needs the header \"Authorization: Bearer …\" with the token of [control] (CTL-1)";
        Self::new(StatusCode::UNAUTHORIZED, "no_token", message)
    }

    /// 403: a Host or Origin that is not ours.
    pub fn foreign(message: impl Into<String>) -> Self {
        Self::new(StatusCode::FORBIDDEN, "foreign", message)
    }

    /// 404: there is no such thing.
    pub fn not_found(message: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, "not_found", message)
    }

    /// 404: there is no such thing, but others of its kind.
    pub fn none_of<'a>(what: &str, name: &str, known: impl IntoIterator<Item = &'a str>) -> Self {
        let known: Vec<&str> = known.into_iter().collect();
        let others = if known.is_empty() { "there is none".into() } else { format!("there is {}", known.join(", ")) };
        Self::not_found(format!("there is no {what} {name}; {others}"))
    }

    /// 405: the path does not take this method.
    pub fn method(message: impl Into<String>) -> Self {
        Self::new(StatusCode::METHOD_NOT_ALLOWED, "wrong_method", message)
    }

    /// 408: the body does not come.
    pub fn slow() -> Self {
        Self::new(StatusCode::REQUEST_TIMEOUT, "too_slow", "the body did not come in time")
    }

    /// 409: not in this state.
    pub fn state(message: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, "wrong_state", message)
    }

    /// 413: the body is too large.
    pub fn too_large() -> Self {
        Self::new(StatusCode::PAYLOAD_TOO_LARGE, "too_large", "a body has at most 1 MiB (CTL-2)")
    }

    /// 422: a value that cannot be taken.
    pub fn value(message: impl Into<String>) -> Self {
        Self::new(StatusCode::UNPROCESSABLE_ENTITY, "bad_value", message)
    }

    /// 422: the device refuses.
    pub fn refused(refusal: &Refusal) -> Self {
        Self::new(StatusCode::UNPROCESSABLE_ENTITY, "refused", refusal.to_string())
    }

    /// 503: the bus has ended, or there is too much of something.
    pub fn unavailable(message: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, "unavailable", message)
    }

    /// About this field.
    pub fn of(mut self, field: impl Into<String>) -> Self {
        self.problem.field = Some(field.into());
        self
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let is_unauthorized = self.status == StatusCode::UNAUTHORIZED;
        let mut response = (self.status, Json(Failure { error: self.problem })).into_response();
        if is_unauthorized {
            response.headers_mut().insert(header::WWW_AUTHENTICATE, header::HeaderValue::from_static("Bearer"));
        }
        response
    }
}
