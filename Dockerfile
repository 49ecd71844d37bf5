# docker build -t pinred .
# docker run --rm pinred compare falling_cat
# docker run --rm -v pinred:/home/pinred pinred compare solo12    # keeps kernels and their key
FROM python:3.13-slim
RUN useradd --create-home pinred
COPY . /source
RUN pip install --no-cache-dir "/source[robots]" && rm -r /source
USER pinred
WORKDIR /home/pinred
# Compile the integrators once, and check the installation.
RUN pinred compare falling_cat && pinred doctor
ENTRYPOINT ["pinred"]
