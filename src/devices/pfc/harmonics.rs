//! Harmonics: how a total distortion spreads over the orders (PFC-10).

/// The orders that are displayed.
pub const ORDERS: usize = 31;

/// Every order of a quantity in % of its fundamental, order 1 first: odd orders fall as 1/n and their root of squares
/// is the distortion; even orders are 0 (PFC-10).
pub fn orders(thd_percent: f64) -> [f64; ORDERS] {
    let odd = || (3..=ORDERS).step_by(2);
    let norm = odd().map(|order| (order as f64).powi(-2)).sum::<f64>().sqrt();
    let mut orders = [0.0; ORDERS];
    orders[0] = 100.0;
    for order in odd() {
        orders[order - 1] = thd_percent / (order as f64 * norm);
    }
    orders
}
