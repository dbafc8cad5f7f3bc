# Trains and compares the quick suite in a container:
#
#     docker build -t fidelity-bench .
#     docker run --rm -v "$PWD/out/results:/bench/results/quick" -v "$PWD/out/reports:/bench/reports/quick" fidelity-bench
#
# On NVIDIA GPUs, with the NVIDIA Container Toolkit on the host:
#
#     docker build --build-arg VARIANT=cuda -t fidelity-bench:cuda .
#     docker run --rm --gpus all fidelity-bench:cuda
ARG PYTHON=3.11
FROM python:${PYTHON}-slim

# cpu or cuda; CUDA itself comes in JAX's wheels, so that both variants stand on the same image.
ARG VARIANT=cpu

# git tells the commit that every row of the tables names.
RUN apt-get update && apt-get install -y --no-install-recommends git make && rm -rf /var/lib/apt/lists/*

WORKDIR /bench
COPY . .

RUN case "$VARIANT" in \
        cpu|cuda) ;; \
        *) echo "VARIANT must be cpu or cuda, got '$VARIANT'." >&2; exit 2 ;; \
    esac \
    && make .venv/.ready \
    && if [ "$VARIANT" = cuda ]; then \
        .venv/bin/python -m pip install --quiet --no-cache-dir -c constraints.txt 'jax[cuda12]'; \
    fi \
    && rm -rf /root/.cache/pip

ENV PATH="/bench/.venv/bin:$PATH"
CMD ["make", "run"]
