# Non-linear mixed effects of R's nlme on recordings with three levels: population, person, repetition.
#
#   Rscript nlme.R recordings.csv start.csv estimates.csv
#
# recordings.csv: person, repetition, omega, part (0 real, 1 imaginary), value, sd
# start.csv, estimates.csv: element, mu and (estimates) tau, rho: log elements, standard deviations of people and repetitions
# The network is that of tests/nuts_model.py: (n3|r3)-(m2|r1|n1). Elements vary independently of each other: with a general
# covariance (pdSymm) nlme 3.1-162 either stops with a fault in its memory or does not end.

suppressPackageStartupMessages(library(nlme))
paths <- commandArgs(trailingOnly = TRUE)
data <- read.csv(paths[1], colClasses = c(person = "factor", repetition = "factor"))
start <- read.csv(paths[2])

impedance <- function(omega, part, sd, n3, r3, m2, r1, n1) {
  s <- 1i * omega
  value <- list(n3 = exp(n3), r3 = exp(r3), m2 = exp(m2), r1 = exp(r1), n1 = exp(n1))
  skin <- 1 / (s * value$n3) + value$r3
  tissue <- s * value$m2 + value$r1 + 1 / (s * value$n1)
  whole <- skin * tissue / (skin + tissue)
  by_skin <- (whole / skin)^2
  by_tissue <- (whole / tissue)^2
  slope <- cbind(
    n3 = -by_skin / (s * value$n3), r3 = by_skin * value$r3, m2 = by_tissue * s * value$m2,
    r1 = by_tissue * value$r1, n1 = -by_tissue / (s * value$n1)
  )
  own <- ifelse(part == 0, Re(whole), Im(whole)) / sd
  attr(own, "gradient") <- ifelse(matrix(part == 0, length(part), 5), Re(slope), Im(slope)) / sd
  dimnames(attr(own, "gradient")) <- list(NULL, colnames(slope))
  own
}

begun <- proc.time()[["elapsed"]]
fit <- nlme(
  I(value / sd) ~ impedance(omega, part, sd, n3, r3, m2, r1, n1),
  data = data,
  fixed = n3 + r3 + m2 + r1 + n1 ~ 1,
  random = list(
    person = pdDiag(n3 + r3 + m2 + r1 + n1 ~ 1),
    repetition = pdDiag(n3 + r3 + m2 + r1 + n1 ~ 1)
  ),
  start = setNames(start$mu, start$element),
  method = "REML",
  control = nlmeControl(maxIter = 100, msMaxIter = 200, tolerance = 1e-3)
)
seconds <- proc.time()[["elapsed"]] - begun

spread <- function(level) as.numeric(sqrt(diag(as.matrix(fit$modelStruct$reStruct[[level]]))) * fit$sigma)
names_of <- names(fixef(fit))
write.csv(
  data.frame(element = names_of, mu = fixef(fit), tau = spread("person"), rho = spread("repetition")),
  paths[3], row.names = FALSE
)
cat("seconds", seconds, "\n")
cat("version", as.character(packageVersion("nlme")), "\n")
